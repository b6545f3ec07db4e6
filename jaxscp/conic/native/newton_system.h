// The Newton system of the interior point and its solution, by elimination of cones, nodes and links (``kkt.py``).
#pragma once

#include "chain.h"
#include "cones.h"
#include "program.h"

namespace jaxscp {

// Nesterov-Todd scaling of the product cone; nothing on the zero cone.
class Scaling {
 public:
  Packs w;    // as a ConeVector: roots of the half-spaces' ratios, and the cones' points
  Packs eta;  // of each cone

  explicit Scaling(const Program& p) : w(p.packs * p.cone.size), eta(p.packs * p.cones.size()), program_(p) {}

  // For slack and multiplier the identity of the cone.
  void set_unit() {
    std::fill(w.begin(), w.end(), all(0.0));
    std::fill(eta.begin(), eta.end(), all(1.0));
    program_.each([&](int at) { w[at] = all(1.0); }, [&](int at, int, int) { w[at] = all(1.0); });
  }

  void set(const Packs& s, const Packs& y) {
    program_.each([&](int at) { w[at] = root(s[at] / y[at]); },
                  [&](int at, int d, int c) { soc::scaling(&s[at], &y[at], d, &w[at], eta[c]); });
  }

  // out = W v, and zero on the zero cone
  void apply(const Packs& v, Packs& out) const {
    program_.clear_zero_cone(out);
    program_.each([&](int at) { out[at] = w[at] * v[at]; },
                  [&](int at, int d, int c) { soc::scale(&w[at], eta[c], 1.0, &v[at], d, &out[at]); });
  }
  void apply_inverse(const Packs& v, Packs& out) const {
    program_.clear_zero_cone(out);
    program_.each([&](int at) { out[at] = v[at] / w[at]; },
                  [&](int at, int d, int c) { soc::scale(&w[at], eta[c], -1.0, &v[at], d, &out[at]); });
  }
  void square(const Packs& v, Packs& out) const {
    program_.clear_zero_cone(out);
    program_.each([&](int at) { out[at] = w[at] * w[at] * v[at]; },
                  [&](int at, int d, int c) { soc::square(&w[at], eta[c], &v[at], d, &out[at]); });
  }

 private:
  const Program& program_;
};

class NewtonSystem {
 public:
  explicit NewtonSystem(const Program& program)
      : program_(program),
        chain_(program.nodes + 1, program.m),
        rows_(program.n + 2 * program.m),
        panels_(static_cast<size_t>(program.packs) * rows_ * program.n),
        below_(static_cast<size_t>(program.packs) * rows_ * kSides),
        trust_shift_(static_cast<size_t>(program.packs) * program.n * kSides),
        right_(program.n),
        both_(program.n * kSides),
        z_(program.n),
        link_(program.m),
        gram_(program.m * program.m),
        wide_(std::max(program.n, program.cone.size)),
        rx_(kSides, Packs(program.packs * program.primal.size)),
        ry_(kSides, Packs(program.packs * program.cone.size)),
        dx_(rx_),
        dy_(ry_) {}

  // A right side and its solution.
  struct Side {
    const Packs &rx, &ry;
    Packs &x, &y;
  };

  // Eliminate cones and nodes, and factor what remains in the link multipliers.
  void factor(const Scaling& scaling, double regularisation) {
    const Program& g = program_;
    int n = g.n, m = g.m;
    chain_.clear();
    add_compliance(scaling, regularisation);
    for (int p = 0; p < g.packs; ++p) {
      Pack* panel = &panels_[static_cast<size_t>(p) * rows_ * n];
      std::fill_n(panel, static_cast<size_t>(rows_) * n, all(0.0));
      add_hessian(scaling, p, panel);
      for (int i = 0; i < n; ++i) panel[i * n + i] += regularisation;
      Pack *after = panel + n * n, *before = after + m * n;
      spread(g.after, p, after);
      spread(g.before, p, before);
      eliminate(panel, n, rows_);
      int here = p * kWidth;
      auto add = [&](const Pack* rows, int shift) {
        gram(rows, rows, m, n, gram_.data());
        for (int i = 0; i < m; ++i)
          for (int j = 0; j <= i; ++j) {
            double* at = chain_.diagonal(i, j) + here + shift;
            store(at, load(at) + g.of_nodes(p, gram_[i * m + j]));
          }
      };
      add(after, 0);
      add(before, 1);
      gram(after, before, m, n, gram_.data());
      for (int i = 0; i < m; ++i)
        for (int j = 0; j < m; ++j) store(chain_.above(i, j) + here, g.of_nodes(p, gram_[i * m + j]));
    }
    chain_.factor();
  }

  // Solve [P A'; A -W^2] (x, y) = (rx, ry) for S sides at once. Refinement is against this full system: it brings
  // back the digits that eliminating cones near their boundary loses.
  template <int S>
  void solve(const Scaling& scaling, int refinements, const Side (&sides)[S]) {
    solve_once<S>(scaling, sides);
    for (int round = 0; round < refinements; ++round) {
      for (int s = 0; s < S; ++s) {
        const Side& side = sides[s];
        Packs &rx = rx_[s], &ry = ry_[s], &dx = dx_[s], &dy = dy_[s];
        program_.times_hessian(side.x, rx);
        program_.times_constraints_transposed(side.y, dx);
        for (size_t i = 0; i < rx.size(); ++i) rx[i] = side.rx[i] - (rx[i] + dx[i]);
        program_.times_constraints(side.x, ry);
        scaling.square(side.y, dy);
        for (size_t i = 0; i < ry.size(); ++i) ry[i] = side.ry[i] - (ry[i] - dy[i]);
      }
      if constexpr (S == 1) solve_once<1>(scaling, {{rx_[0], ry_[0], dx_[0], dy_[0]}});
      else solve_once<2>(scaling, {{rx_[0], ry_[0], dx_[0], dy_[0]}, {rx_[1], ry_[1], dx_[1], dy_[1]}});
      for (int s = 0; s < S; ++s) {
        for (size_t i = 0; i < dx_[s].size(); ++i) sides[s].x[i] += dx_[s][i];
        for (size_t i = 0; i < dy_[s].size(); ++i) sides[s].y[i] += dy_[s][i];
      }
    }
  }

 private:
  Pack eta(const Scaling& s, int p, size_t cone) const { return s.eta[p * program_.cones.size() + cone]; }

  void spread(const Matrix& sparse, int p, Pack* dense) const {
    const Pack* a = sparse.at(p);
    for (int i = 0; i < sparse.rows(); ++i)
      for (int e = sparse.start[i]; e < sparse.start[i + 1]; ++e) dense[i * program_.n + sparse.column[e]] = a[e];
  }

  // Lower triangle of P + G' W^-2 G, the trust region's cone with its bound eliminated.
  void add_hessian(const Scaling& s, int p, Pack* h) {
    const Program& g = program_;
    int n = g.n;
    const Pack* w = &s.w[p * g.cone.size];
    spread(g.hessian, p, h);
    for (int i = 0; i < g.r; ++i) add_square(g.rows, p, i, 1.0 / (w[i] * w[i]), h);
    for (size_t c = 0; c < g.user_cones(); ++c) {
      auto [offset, d, _] = g.cones[c];
      Pack by = 1.0 / (eta(s, p, c) * eta(s, p, c));
      int row = offset - g.r;
      Pack* along = wide_.data();
      std::fill_n(along, n, all(0.0));
      for (int i = 0; i < d; ++i) {
        add_square(g.user, p, row + i, i == 0 ? -by : by, h);
        g.user.add_transposed(p, row + i, i == 0 ? w[offset] : -w[offset + i], along);
      }
      for (int i = 0; i < n; ++i) {
        Pack v = 2.0 * by * along[i];
        for (int j = 0; j <= i; ++j) h[i * n + j] += v * along[j];
      }
    }
    if (!g.has_norm) return;
    const Pack *w1 = w + g.trust + 1, *scale = &g.scale[p * n];
    Pack e = eta(s, p, g.trust_cone()), by = 1.0 / (e * e), size = dot(w1, w1, n);
    Pack share = 2.0 / (1.0 + 2.0 * size);
    for (int i = 0; i < n; ++i) {
      Pack v = by * share * scale[i] * w1[i];
      for (int j = 0; j <= i; ++j) h[i * n + j] -= v * scale[j] * w1[j];
      h[i * n + i] += by * scale[i] * scale[i];
    }
  }

  // h += weight a a' for row i of a matrix.
  void add_square(const Matrix& matrix, int p, int i, Pack weight, Pack* h) const {
    const Pack* a = matrix.at(p);
    for (int e = matrix.start[i]; e < matrix.start[i + 1]; ++e) {
      Pack v = weight * a[e];
      for (int f = matrix.start[i]; f <= e; ++f) h[matrix.column[e] * program_.n + matrix.column[f]] += v * a[f];
    }
  }

  // What the eliminated virtual controls leave: (W^2)_{11} on soft rows.
  void add_compliance(const Scaling& s, double regularisation) {
    const Program& g = program_;
    for (int p = 0; p < g.packs; ++p) {
      const Pack *w1 = &s.w[p * g.cone.size + g.virtual_ + 1], *soft = &g.soft[p * g.m];
      Pack by = eta(s, p, g.virtual_cone()) * eta(s, p, g.virtual_cone());
      for (int i = 0; i < g.m; ++i)
        for (int j = 0; j <= i; ++j) {
          Pack v = 2.0 * by * soft[i] * w1[i] * soft[j] * w1[j];
          if (i == j) v += by * soft[i] * soft[i] + regularisation;
          double* at = chain_.diagonal(i, j) + p * kWidth;
          store(at, where(g.is_link[p], v, load(at)));
        }
    }
  }

  template <int S>
  void solve_once(const Scaling& w, const Side (&sides)[S]) {
    const Program& g = program_;
    int n = g.n, m = g.m;
    chain_.clear_vector();
    for (int p = 0; p < g.packs; ++p) {
      for (int s = 0; s < S; ++s) {
        reduce(w, p, sides[s].rx, sides[s].ry, trust_shift(p, s));
        for (int i = 0; i < n; ++i) both_[i * S + s] = right_[i];
      }
      Pack* v = &below_[p * rows_ * kSides];
      descend<S>(&panels_[static_cast<size_t>(p) * rows_ * n], n, rows_, both_.data(), v);
      for (int s = 0; s < S; ++s)
        for (int i = 0; i < m; ++i) {
          double* at = chain_.vector(i, s) + p * kWidth;
          Pack here = g.of_nodes(p, v[(n + i) * S + s]) - lacks(w, p, i, sides[s].rx, sides[s].ry);
          store(at, load(at) + g.of_links(p, here));
          store(at + 1, load(at + 1) + g.of_nodes(p, v[(n + m + i) * S + s]));  // to the link after the node
        }
    }
    chain_.solve<S>();
    for (int p = 0; p < g.packs; ++p) {
      Pack* v = &below_[p * rows_ * kSides];
      for (int i = 0; i < m; ++i)
        for (int s = 0; s < S; ++s) {
          const double* link = chain_.vector(i, s) + p * kWidth;
          v[(n + i) * S + s] = load(link);
          v[(n + m + i) * S + s] = load(link + 1);
        }
      ascend<S>(&panels_[static_cast<size_t>(p) * rows_ * n], n, rows_, v);
      for (int s = 0; s < S; ++s) {
        for (int i = 0; i < n; ++i) z_[i] = v[i * S + s];
        for (int i = 0; i < m; ++i) link_[i] = v[(n + i) * S + s];
        conclude(w, p, trust_shift(p, s), sides[s]);
      }
    }
  }

  Pack* trust_shift(int p, int side) { return &trust_shift_[(p * kSides + side) * program_.n]; }

  // The right side of a node's variables, cones and bounds eliminated, into ``right_``.
  void reduce(const Scaling& s, int p, const Packs& rx, const Packs& ry, Pack* shift) {
    const Program& g = program_;
    int n = g.n;
    const Pack *qx = &rx[p * g.primal.size], *qy = &ry[p * g.cone.size], *w = &s.w[p * g.cone.size];
    for (int i = 0; i < n; ++i) right_[i] = qx[i];
    for (int i = 0; i < g.r; ++i) g.rows.add_transposed(p, i, qy[i] / (w[i] * w[i]), right_.data());
    for (size_t c = 0; c < g.user_cones(); ++c) {
      auto [offset, d, _] = g.cones[c];
      soc::inverse_square(w + offset, eta(s, p, c), qy + offset, d, wide_.data());
      for (int i = 0; i < d; ++i) g.user.add_transposed(p, offset - g.r + i, wide_[i], right_.data());
    }
    if (!g.has_norm) return;
    const Pack* wt = w + g.trust;
    Pack e = eta(s, p, g.trust_cone()), head = 2.0 * e * e * wt[0] * qx[g.xi];
    for (int i = 0; i < n; ++i) shift[i] = qy[g.trust + 1 + i] - head * wt[1 + i];
    soc::tail_inverse(wt, e, shift, n, wide_.data());
    for (int i = 0; i < n; ++i) right_[i] -= g.scale[p * n + i] * wide_[i];
  }

  // The right side of a link's row, its virtual control's bound eliminated.
  Pack lacks(const Scaling& s, int p, int i, const Packs& rx, const Packs& ry) const {
    const Program& g = program_;
    const Pack *qy = &ry[p * g.cone.size], *w = &s.w[p * g.cone.size + g.virtual_];
    Pack soft = g.soft[p * g.m + i], e = eta(s, p, g.virtual_cone());
    Pack tail = qy[g.virtual_ + 1 + i] - 2.0 * e * e * w[0] * rx[p * g.primal.size + g.zeta] * w[1 + i];
    return (1.0 - soft) * qy[g.zero + i] + soft * tail;
  }

  // Everything that was eliminated, from ``z_`` and the multipliers ``link_``.
  void conclude(const Scaling& s, int p, const Pack* shift, const Side& side) {
    const Program& g = program_;
    int n = g.n, m = g.m;
    const Pack *qx = &side.rx[p * g.primal.size], *qy = &side.ry[p * g.cone.size], *w = &s.w[p * g.cone.size];
    Pack *ox = &side.x[p * g.primal.size], *oy = &side.y[p * g.cone.size];
    const Pack* z = z_.data();
    for (int i = 0; i < n; ++i) ox[i] = z[i];
    for (int i = 0; i < g.r; ++i) oy[i] = (g.rows.times(p, i, z) - qy[i]) / (w[i] * w[i]);
    for (size_t c = 0; c < g.user_cones(); ++c) {
      auto [offset, d, _] = g.cones[c];
      for (int i = 0; i < d; ++i) wide_[i] = g.user.times(p, offset - g.r + i, z) - qy[offset + i];
      soc::inverse_square(w + offset, eta(s, p, c), wide_.data(), d, oy + offset);
    }
    // The bounds follow from the heads of their cones:  -xi - (W^2 y)_0 = ry_0.
    ox[g.xi] = all(0.0);
    if (g.has_norm) {
      const Pack *wt = w + g.trust, *scale = &g.scale[p * n];
      Pack e = eta(s, p, g.trust_cone()), *tail = oy + g.trust + 1;
      for (int i = 0; i < n; ++i) wide_[i] = -(scale[i] * z[i] + shift[i]);
      soc::tail_inverse(wt, e, wide_.data(), n, tail);
      oy[g.trust] = -qx[g.xi];
      ox[g.xi] = -qy[g.trust] - square_head(wt, e, oy + g.trust, 1 + n);
    }
    const Pack* wv = w + g.virtual_;
    oy[g.virtual_] = -qx[g.zeta];
    for (int i = 0; i < m; ++i) {
      Pack v = g.soft[p * m + i], l = link_[i];
      oy[g.zero + i] = (1.0 - v) * l;
      oy[g.virtual_ + 1 + i] = v * l;
    }
    ox[g.zeta] = -qy[g.virtual_] - square_head(wv, eta(s, p, g.virtual_cone()), oy + g.virtual_, 1 + m);
  }

  static Pack square_head(const Pack* w, Pack eta, const Pack* v, int d) {
    return eta * eta * (w[0] * 2.0 * dot(w, v, d) - v[0]);
  }

  const Program& program_;
  Chain chain_;
  int rows_;  // of a panel: z, its link, and the link after it
  Packs panels_, below_, trust_shift_, right_, both_, z_, link_, gram_, wide_;
  std::vector<Packs> rx_, ry_, dx_, dy_;
};

}  // namespace jaxscp
