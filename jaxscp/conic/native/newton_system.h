// KKT system of the interior point, solved by elimination of cones, nodes and links (``kkt.py``).
#pragma once

#include "nodes.h"
#include "scaling.h"
#include "squares.h"

namespace jaxscp {

class NewtonSystem {
 public:
  NewtonSystem(const Program& program, Arena& arena)
      : program_(program),
        chain_(program, arena),
        nodes_(program, arena) {
    for (int s = 0; s < kMaxRhs; ++s) {
      scratch_[s] = arena.take(program.packs * program.zero);
      rx_[s] = arena.take(program.packs * program.primal.size), dx_[s] = arena.take(rx_[s].size);
      ry_[s] = arena.take(program.packs * program.cone.size), dy_[s] = arena.take(ry_[s].size);
      trust_shift_[s] = arena.take(program.packs * program.n);
      refinement_[s] = {rx_[s], ry_[s], dx_[s], dy_[s]};
    }
  }

  // Right-hand side (rx, ry) and solution (x, y). On a GPU they must be in shared memory; otherwise each thread would
  // have a copy.
  struct KKTVectors {
    Packs rx, ry, x, y;
  };

  // Prepares for the program that was read.
  void read() { nodes_.read(); }

  // Eliminates cones and nodes, and factors the Schur complement in the link multipliers.
  JAXSCP_CALLED void factor(const Scaling& scaling, double regularisation) {
    const Program& g = program_;
    // Compliance of the soft rows, from eliminated virtual control: (W^2)_{11} = eta^2 (2 w1 w1' + 1).
    auto along = [&](int p, int i) {
      Pack eta = scaling.eta_of(p, g.virtual_cone);
      return kRootOfTwo * eta * g.soft.of(p, g.m)[i] * g.of_cones(scaling.w, p)[g.virtual_ + 1 + i];
    };
    auto diagonal = [&](int p, int i) {
      Pack part = scaling.eta_of(p, g.virtual_cone) * g.soft.of(p, g.m)[i];
      return part * part + regularisation;
    };
    auto add = [&](int p, auto to, Pack* buffer) { add_hessian(scaling, regularisation, p, to, buffer); };
    nodes_.factor(chain_, scaling, regularisation, add, along, diagonal);
  }

  // Solves [P A'; A -W^2] (x, y) = (rx, ry) for S right-hand sides at once. Refinement uses residuals of this full
  // system, and so restores the digits that the elimination of cones near their boundary loses.
  template <int S>
  JAXSCP_CALLED void solve(const Scaling& scaling, int refinements, const KKTVectors* systems) {
    solve_once<S>(scaling, systems);
    for (int round = 0; round < refinements; ++round) {
      for (int s = 0; s < S; ++s) program_.times(systems[s].x, systems[s].y, rx_[s], ry_[s], dx_[s]);
      parallel_for(program_.packs, program_.parts(S), [&](int p, int k) {
        residual(scaling, systems[k % S], refinement_[k % S], p, k / S);
      });
      solve_once<S>(scaling, refinement_);
      const int rows = dx_[0].size, all_rows = rows + dy_[0].size;
      parallel_for(all_rows * S, [&](int k) {
        const int s = k / all_rows, i = k % all_rows;
        if (i < rows) systems[s].x[i] += dx_[s][i];
        else systems[s].y[i - rows] += dy_[s][i - rows];
      });
    }
  }

 private:
  // Residual of a solution, at part k of a stage, written to rx and ry of ``to``, which holds P x, A x and A'y in rx,
  // ry and x.
  void residual(const Scaling& scaling, const KKTVectors& system, const KKTVectors& to, int p, int k) const {
    const Program& g = program_;
    Entries ry = g.of_cones(system.ry, p), y = g.of_cones(system.y, p), w = g.of_cones(scaling.w, p);
    Entries out = g.of_cones(to.ry, p), square = g.of_cones(to.y, p);
    g.part(k, [&](int i) { out[i] = ry[i] - (out[i] - w[i] * w[i] * y[i]); },
           [&](int i, int d, int c) {
             soc::ConeRegisters squared = soc::output(square + i, d), left = soc::load(out + i, d);
             const soc::ConeRegisters right = soc::load(ry + i, d);
             soc::square(soc::load(w + i, d), scaling.eta_of(p, c), soc::load(y + i, d), squared);
             soc::each(left, [&](int j) { return right[j] - (left[j] - squared[j]); });
             soc::store(left, out + i);
           },
           [&](int i) { out[i] = ry[i] - out[i]; },
           [&](int i) {
             Entries px = g.of_primal(to.rx, p);
             px[i] = g.of_primal(system.rx, p)[i] - (px[i] + g.of_primal(to.x, p)[i]);
           });
  }

  // Adds the lower triangle of the node's Hessian P + G' W^-2 G, with the trust region's bound eliminated. ``along`` is
  // a buffer for a vector.
  template <typename Triangle>
  void add_hessian(const Scaling& s, double regularisation, int p, Triangle to, Pack* along) {
    const Program& g = program_;
    const int n = g.n;
    g.hessian.each(p, [&](int i, int j, Pack v) { to(i, j) = v; });
    add_squares(g, s, p, scratch(p, 0), along, to);
    if (g.has_norm) {
      Entries w1 = g.of_cones(s.w, p) + (g.trust + 1), scale = g.scale.of(p, n);
      Pack e = s.eta_of(p, g.trust_cone), by = inverse(e * e), size = soc::dot(soc::load(w1, n), soc::load(w1, n));
      in_team(n, [&](int i) {
        along[i] = scale[i] * w1[i];
        to(i, i) += by * scale[i] * scale[i];
      });
      add_square(n, -by * 2.0 * inverse(1.0 + 2.0 * size), along, to);
    }
    in_team(n, [&](int i) { to(i, i) += regularisation; });
  }

  template <int S>
  JAXSCP_CALLED void solve_once(const Scaling& w, const KKTVectors* systems) {
    reduce<S>(w, systems);
    nodes_.template solve<S>(
        chain_, [&](int p, int i, int s) { return link_rhs(w, p, i, systems[s].rx, systems[s].ry); });
    conclude<S>(w, systems);
  }

  // Right-hand sides of the nodes' variables, with cones and bounds eliminated.
  template <int S>
  JAXSCP_CALLED void reduce(const Scaling& scaling, const KKTVectors* systems) {
    const Program& g = program_;
    const int n = g.n;
    parallel_for(g.packs, Parts{g.r * S, (g.user_cones + g.has_norm) * S}, [&](int p, int k) {
      reduce_part(scaling, systems[k % S], k % S, p, k / S);
    });
    parallel_for(g.packs, Parts{n * S}, [&](int p, int k) {
      const int j = k / S, s = k % S;
      Entries v = scratch(p, s);
      Pack total = g.rows.add_transposed(p, j, g.of_primal(systems[s].rx, p)[j], [&](int i) { return v[i]; });
      total = g.user.add_transposed(p, j, total, [&](int i) { return v[g.r + i]; });
      if (g.has_norm) total -= g.scale.of(p, n)[j] * v[g.trust + 1 + j];
      nodes_.template right<S>(p, j, s) = total;
    });
  }

  // Contribution of row or cone k of a node.
  void reduce_part(const Scaling& scaling, const KKTVectors& system, int s, int p, int k) {
    const Program& g = program_;
    const int n = g.n;
    Entries qx = g.of_primal(system.rx, p), qy = g.of_cones(system.ry, p), w = g.of_cones(scaling.w, p);
    Entries out = scratch(p, s);
    if (k < g.r) {
      out[k] = qy[k] * inverse(w[k] * w[k]);
    } else if (k < g.r + g.user_cones) {
      auto [offset, d, _] = g.cone_at(k - g.r);
      soc::ConeRegisters found = soc::output(out + offset, d);
      soc::inverse_square(soc::load(w + offset, d), scaling.eta_of(p, k - g.r), soc::load(qy + offset, d), found);
      soc::store(found, out + offset);
    } else {
      const Entries of_shift = trust_shift_[s].of(p, n), to = out + (g.trust + 1);
      const Pack e = scaling.eta_of(p, g.trust_cone), by = 2.0 * e * e * w[g.trust] * qx[g.xi];
      const soc::ConeRegisters tail = soc::load(w + (g.trust + 1), n), right = soc::load(qy + (g.trust + 1), n);
      soc::ConeRegisters shift = soc::output(of_shift, n), found = soc::output(to, n);
      soc::each(shift, [&](int i) { return right[i] - by * tail[i]; });
      soc::tail_inverse(tail, e, shift, found);
      soc::store(shift, of_shift), soc::store(found, to);
    }
  }

  // Right-hand side of a link's row, with the bound of virtual control eliminated.
  Pack link_rhs(const Scaling& s, int p, int i, Packs rx, Packs ry) const {
    const Program& g = program_;
    Entries qy = g.of_cones(ry, p), w = g.of_cones(s.w, p) + g.virtual_;
    Pack soft = g.soft.of(p, g.m)[i], e = s.eta_of(p, g.virtual_cone);
    Pack tail = qy[g.virtual_ + 1 + i] - 2.0 * e * e * w[0] * g.of_primal(rx, p)[g.zeta] * w[1 + i];
    return (1.0 - soft) * qy[g.zero + i] + soft * tail;
  }

  // Eliminated unknowns, from the nodes' variables and the multipliers of the links.
  template <int S>
  JAXSCP_CALLED void conclude(const Scaling& scaling, const KKTVectors* systems) {
    const Program& g = program_;
    const int n = g.n, m = g.m;
    parallel_for(g.packs, Parts{(n + m) * S}, [&](int p, int k) {
      const int i = k / S, s = k % S;
      const KKTVectors& system = systems[s];
      if (i < n) {
        g.of_primal(system.x, p)[i] = nodes_.template solution<S>(p, i, s);
      } else {
        const Pack found = chain_.solution(p, i - n, s), v = g.soft.of(p, m)[i - n];
        g.of_cones(system.y, p)[g.zero + i - n] = (1.0 - v) * found;
        g.of_cones(system.y, p)[g.virtual_ + 1 + i - n] = v * found;
      }
    });
    parallel_for(g.packs, Parts{g.r * S, g.cone_count * S}, [&](int p, int k) {
      conclude_part(scaling, systems[k % S], k % S, p, k / S);
    });
  }

  // Multipliers of row or cone k of a stage, and the bounds of the norms.
  void conclude_part(const Scaling& scaling, const KKTVectors& system, int s, int p, int k) {
    const Program& g = program_;
    const int n = g.n, m = g.m;
    Entries qx = g.of_primal(system.rx, p), qy = g.of_cones(system.ry, p), w = g.of_cones(scaling.w, p);
    Entries ox = g.of_primal(system.x, p), oy = g.of_cones(system.y, p);
    if (k < g.r) {
      oy[k] = (g.rows.times(p, k, ox) - qy[k]) * inverse(w[k] * w[k]);
      return;
    }
    int c = k - g.r;
    Pack e = scaling.eta_of(p, c);
    if (c < g.user_cones) {
      auto [offset, d, _] = g.cone_at(c);
      const soc::ConeRegisters right = soc::load(qy + offset, d);
      soc::ConeRegisters v = soc::output(scratch(p, s) + offset, d), found = soc::output(oy + offset, d);
      soc::each_entry(v, [&](int i, int entry) { return g.user.times(p, offset - g.r + entry, ox) - right[i]; });
      soc::inverse_square(soc::load(w + offset, d), e, v, found);
      soc::store(found, oy + offset);
    } else if (c == g.virtual_cone) {
      // The bounds follow from the heads of their cones:  -xi - (W^2 y)_0 = ry_0.
      oy[g.virtual_] = -qx[g.zeta];
      const soc::ConeRegisters point = soc::load(w + g.virtual_, 1 + m), found = soc::load(oy + g.virtual_, 1 + m);
      ox[g.zeta] = -qy[g.virtual_] - soc::square_head(point, e, found);
      if (!g.has_norm) ox[g.xi] = all(0.0);
    } else {
      const Entries to = oy + g.trust;
      const soc::ConeRegisters tail = soc::load(w + (g.trust + 1), n), scale = soc::load(g.scale.of(p, n), n);
      const soc::ConeRegisters x = soc::load(ox, n), shift = soc::load(trust_shift_[s].of(p, n), n);
      soc::ConeRegisters v = soc::output(scratch(p, s) + g.trust, n), found = soc::output(to + 1, n);
      soc::each(v, [&](int i) { return -(scale[i] * x[i] + shift[i]); });
      soc::tail_inverse(tail, e, v, found);
      soc::store(found, to + 1);
      // (W^2 y)_0 with y = (-rx_xi, tail)
      const Pack first = -qx[g.xi], w0 = w[g.trust];
      to[0] = first;
      ox[g.xi] = -qy[g.trust] - e * e * (w0 * 2.0 * (w0 * first + soc::dot(tail, found)) - first);
    }
  }

  const Program& program_;
  Chain chain_;
  Nodes nodes_;
  static constexpr double kRootOfTwo = 1.4142135623730951;
  Entries scratch(int p, int system) const { return scratch_[system].of(p, program_.zero); }

  Packs scratch_[kMaxRhs];  // ConeVectors without links, passed from one phase to the next
  Packs trust_shift_[kMaxRhs], rx_[kMaxRhs], ry_[kMaxRhs], dx_[kMaxRhs], dy_[kMaxRhs];
  KKTVectors refinement_[kMaxRhs];  // right-hand sides and solutions of the refinement
};

}  // namespace jaxscp
