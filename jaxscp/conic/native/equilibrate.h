// Ruiz equilibration of a program, as in ``conic/equilibrate.py``.
#pragma once

#include "program.h"

namespace jaxscp {

class Scales {
 public:
  Packs columns, links, rows, user;  // ``user``: rows of the user's cones, with one scale per cone
  double cost = 1.0;

  Scales(Program& program, Arena& arena)
      : columns(arena.take(program.packs * program.n)), links(arena.take(program.packs * program.m)),
        rows(arena.take(program.packs * program.r)), user(arena.take(program.packs * program.u)), program_(program),
        columns_(arena.take(columns.size)), links_(arena.take(links.size)), rows_(arena.take(rows.size)),
        user_(arena.take(user.size)), before_(arena.take(links.size)) {}

  // Finds the scales of the program, and scales the program.
  JAXSCP_CALLED void apply(int rounds) {
    for (Packs v : {columns, links, rows, user}) parallel_for(v.size, [&](int i) { v[i] = all(1.0); });
    once([&] { cost = 1.0; });
    for (int round = 0; round < rounds; ++round) {
      measure();
      refine();
    }
    scale_matrices();
    scale_vectors();
  }

  // Scales variables x and multipliers y, except the heads of the norms' cones.
  JAXSCP_CALLED void apply(Packs x, Packs y) const {
    const Program& g = program_;
    parallel_for(g.packs, Parts{g.n}, [&](int p, int j) {
      g.of_primal(x, p)[j] = g.of_primal(x, p)[j] / columns.of(p, g.n)[j];
    });
    multiply_rows(y, [&](Pack scale) { return cost / scale; });
  }

 private:
  static constexpr double kLowest = 1e-4, kHighest = 1e4, kEmpty = 1e-12;

  // Scale of row i: half-spaces first, then rows of the user's cones.
  Pack of_row(int p, int i) const {
    return i < program_.r ? rows.of(p, program_.r)[i] : user.of(p, program_.u)[i - program_.r];
  }

  // Largest entries of the scaled program in each column, row and cone.
  JAXSCP_CALLED void measure() {
    const Program& g = program_;
    parallel_for(g.packs, Parts{g.m}, [&](int p, int i) { before_.of(p, g.m)[i] = largest(g.before, p, i); });
    parallel_for(g.packs, Parts{g.n + g.m + g.r + g.user_cones}, [&](int p, int k) {
      if (k < g.n) {
        columns_.of(p, g.n)[k] = columns.of(p, g.n)[k] * largest_of_column(p, k);
      } else if (const int i = k - g.n; i < g.m) {
        Pack from_before = one_before(p > 0 ? before_.of(p - 1, g.m)[i] : all(0.0), before_.of(p, g.m)[i]);
        links_.of(p, g.m)[i] = links.of(p, g.m)[i] * larger(largest(g.after, p, i), from_before);
      } else if (const int row = i - g.m; row < g.r) {
        rows_.of(p, g.r)[row] = rows.of(p, g.r)[row] * largest(g.rows, p, row);
      } else {
        const Cone cone = g.cone_at(row - g.r);
        const int first = cone.offset - g.r;
        Pack found = all(0.0);
        for (int j = first; j < first + cone.dimension; ++j) found = larger(largest(g.user, p, j), found);
        for (int j = first; j < first + cone.dimension; ++j) user_.of(p, g.u)[j] = user.of(p, g.u)[j] * found;
      }
    });
  }

  // Largest entry of a row, without the row's own scale.
  Pack largest(const Matrix& matrix, int p, int i) const {
    Entries a = matrix.at(p), c = columns.of(p, program_.n);
    Pack found = all(0.0);
    matrix.each_of_row(i, [&](int e, int j) { found = larger(magnitude(a[e]) * c[j], found); });
    return found;
  }
  Pack largest_of_column(int p, int j) const {
    const Program& g = program_;
    Entries c = columns.of(p, g.n), link = links.of(p, g.m), next = links.of(p + 1, g.m);
    const bool last = p + 1 == g.packs;
    Pack found = all(0.0);
    auto include = [&](const Matrix& matrix, auto scale) {
      Entries a = matrix.at(p);
      matrix.each_of_column(j, [&](int e, int i) { found = larger(magnitude(a[e]) * scale(i), found); });
    };
    include(g.hessian, [&](int i) { return cost * c[i]; });
    include(g.after, [&](int i) { return link[i]; });
    include(g.before, [&](int i) { return one_after(link[i], last ? all(0.0) : next[i]); });
    include(g.rows, [&](int i) { return of_row(p, i); });
    include(g.user, [&](int i) { return of_row(p, g.r + i); });
    return found;
  }

  JAXSCP_CALLED void refine() {
    const Program& g = program_;
    using Largest = Totals<0, 1>;
    const double largest = fold(g.packs, Parts{g.n + 1}, Largest::none(), [&](int p, int j, Largest& found) {
      Pack v = cost * magnitude(g.of_primal(g.q, p)[j < g.n ? j : g.xi]);
      if (j < g.n) v = v * columns.of(p, g.n)[j] * shrunk(columns_.of(p, g.n)[j]);
      found.include_max(0, g.of_nodes(p, v));
    }).largest(0);
    auto change = [&](Packs scales, Packs sizes) {
      parallel_for(scales.size, [&](int i) { scales[i] = clipped(scales[i] * shrunk(sizes[i])); });
    };
    change(columns, columns_), change(rows, rows_), change(user, user_);
    parallel_for(g.packs, Parts{g.m}, [&](int p, int i) {
      Entries scale = links.of(p, g.m);
      const Pack size = where(g.soft.of(p, g.m)[i] > 0.0, largest_of_soft(links_, p), links_.of(p, g.m)[i]);
      scale[i] = clipped(scale[i] * shrunk(size));
    });
    // Without linear terms the cost has no known size. A tiny size would inflate the penalty weights of the links.
    once([&] { cost /= largest > 0.0 ? largest < kLowest ? kLowest : largest > kHighest ? kHighest : largest : 1.0; });
  }

  // Largest entry among a link's soft rows, which share one scale.
  Pack largest_of_soft(Packs v, int p) const {
    Entries soft = program_.soft.of(p, program_.m), of = v.of(p, program_.m);
    Pack found = all(0.0);
    for (int i = 0; i < program_.m; ++i) found = larger(soft[i] * of[i], found);
    return found;
  }

  JAXSCP_CALLED void scale_matrices() {
    Program& g = program_;
    auto column = [&](int p, int j) { return columns.of(p, g.n)[j]; };
    auto link = [&](int p, int i) { return links.of(p, g.m)[i]; };
    auto next = [&](int p, int i) { return one_after(link(p, i), p + 1 == g.packs ? all(0.0) : link(p + 1, i)); };
    g.hessian.scale(g.packs, [&](int p, int i) { return cost * column(p, i); }, column);
    g.after.scale(g.packs, link, column);
    g.before.scale(g.packs, next, column);
    g.rows.scale(g.packs, [&](int p, int i) { return of_row(p, i); }, column);
    g.user.scale(g.packs, [&](int p, int i) { return of_row(p, g.r + i); }, column);
  }

  JAXSCP_CALLED void scale_vectors() {
    const Program& g = program_;
    parallel_for(g.packs, Parts{g.primal.size}, [&](int p, int j) {
      Pack by = all(cost);
      if (j < g.n) {
        const Pack column = columns.of(p, g.n)[j];
        by = cost * column;
        if (g.has_norm) g.scale.of(p, g.n)[j] = column * g.scale.of(p, g.n)[j];  // scale * centre is unchanged
      } else if (j == g.zeta) {
        const Pack shared = largest_of_soft(links, p);
        by = cost / where(shared > 0.0, shared, all(1.0));
      }
      g.of_primal(g.q, p)[j] = by * g.of_primal(g.q, p)[j];
    });
    multiply_rows(g.b, [](Pack scale) { return scale; });
  }

  // Multiplies a ConeVector by factor(scale of the row), except the trust region's cone and virtual control's head.
  template <typename Factor>
  void multiply_rows(Packs of, Factor factor) const {
    const Program& g = program_;
    parallel_for(g.packs, Parts{g.r + g.u + g.m}, [&](int p, int i) {
      Entries v = g.of_cones(of, p);
      if (i < g.r + g.u) {
        v[i] = factor(of_row(p, i)) * v[i];
      } else {
        const int l = i - g.r - g.u;
        const Pack by = factor(links.of(p, g.m)[l]);
        v[g.zero + l] = by * v[g.zero + l], v[g.virtual_ + 1 + l] = by * v[g.virtual_ + 1 + l];
      }
    });
  }

  static Pack shrunk(Pack size) { return where(size > kEmpty, 1.0 / root(larger(size, all(kEmpty))), all(1.0)); }
  static Pack clipped(Pack scale) { return smaller(larger(scale, all(kLowest)), all(kHighest)); }

  Program& program_;
  Packs columns_, links_, rows_, user_;  // largest entries
  Packs before_;                         // largest entries of the links' rows in E, the matrix of the node before
};

}  // namespace jaxscp
