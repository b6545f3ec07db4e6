// Program in conic form, in packs (``conic_form.py`` has the mathematics):
//
//     min 1/2 x'Px + q'x,   A x + s = b,   s in K,      x = (z, xi, zeta)
//
// A stage holds the entries of its node and of the link before the node.
#pragma once

#include "matrix.h"

namespace jaxscp {

class Program : public ProgramLayout {
 public:
  Matrix hessian, after, before, rows, user;  // ``before``: E of the link after the node
  Packs soft, scale;
  Packs q, b;
  ProgramData data;  // arrays that the program is read from
  bool changed = false;  // whether the sparsity differs from the last program's

  Program(const Layout& layout, Arena& arena)
      : ProgramLayout(layout), hessian(n, n, packs, arena), after(m, n, packs, arena), before(m, n, packs, arena),
        rows(r, n, packs, arena), user(u, n, packs, arena), soft(arena.take(packs * m)), scale(arena.take(packs * n)),
        q(arena.take(packs * primal.size)), b(arena.take(packs * cone.size)), carry_(arena.take(packs * m)),
        multiplier_(arena.take(packs * m)) {}

  // Reads the program from ``data``.
  JAXSCP_CALLED void read() {
    const ProgramData& g = data;
    once([&] { changed = false; });
    read_matrices();
    if (changed) {
      FastIndices fast;
      each_matrix([&](Matrix& matrix, MatrixSource) { matrix.enumerate(fast); });
      rows.copy_numbers(fast), user.copy_numbers(fast);
      read_matrices();
    }
    gather(g.soft, nodes + 1, m, soft, 0, m);

    parallel_for(q.size, [&](int i) { q[i] = all(0.0); });  // its barrier also waits for ``soft``
    gather(g.gradient, nodes, n, q, 0, primal.size);
    gather(g.penalty_weight, nodes + 1, 1, q, zeta, primal.size);
    gather_cones(g.row_offset, 1.0, &ProgramData::ConeGroup::offset, g.link_offset, b);
    if (has_norm) {
      gather(g.norm_weight, nodes, 1, q, xi, primal.size);
      gather(g.norm_scale, nodes, n, scale, 0, n);
      gather(g.norm_centre, nodes, n, b, trust + 1, cone.size);
      wait();
      parallel_for(packs, Parts{n}, [&](int p, int i) { of_cones(b, p)[trust + 1 + i] *= -scale.of(p, n)[i]; });
    }
  }

  // Reads the warm start: variables without bounds of norms, and multipliers. The heads of the norms' multipliers equal
  // the weights of the norms. The trust region's tail is unknown: zero.
  JAXSCP_CALLED void read_warm_start(Packs x, Packs y) const {
    const ProgramData& g = data;
    parallel_for(x.size, [&](int i) { x[i] = all(0.0); });
    gather(g.warm_z, nodes, n, x, 0, primal.size);
    gather_cones(g.warm_rows, 0.0, &ProgramData::ConeGroup::warm, g.warm_links, y);
    parallel_for(packs, Parts{1}, [&](int p, int) {
      of_cones(y, p)[virtual_] = of_primal(q, p)[zeta];
      if (has_norm) of_cones(y, p)[trust] = of_primal(q, p)[xi];
    });
  }

  // Entries of a Primal (z, xi, zeta) and of a ConeVector at one stage.
  Entries of_primal(Packs v, int p) const { return v.of(p, primal.size); }
  Entries of_cones(Packs v, int p) const { return v.of(p, cone.size); }

  // P x, A x and A'y.
  JAXSCP_CALLED void times(Packs x, Packs y, Packs px, Packs ax, Packs aty) const {
    begin_times(x, y);
    parallel_for(packs, products(), [&](int p, int k) {
      product(p, k, x, y, [&](int i, Pack v) { of_cones(ax, p)[i] = v; },
              [&](int j, Pack curved, Pack dual) { of_primal(px, p)[j] = curved, of_primal(aty, p)[j] = dual; });
    });
  }

  // A x alone.
  JAXSCP_CALLED void times_constraints(Packs x, Packs ax) const {
    parallel_for(packs, Parts{m}, [&](int p, int k) { carry_.of(p, m)[k] = carried(p, k, x); });
    parallel_for(packs, Parts{constraints()}, [&](int p, int k) {
      constraint(p, k, of_primal(x, p), [&](int i, Pack v) { of_cones(ax, p)[i] = v; });
    });
  }

  // The same products by parts, for callers that use each entry at once. First ``begin_times`` computes contributions
  // to neighbouring stages. Then part k of a stage calls row(i, entry i of A x), twice for a row of a link, or
  // variable(j, entry j of P x, entry j of A'y).
  JAXSCP_CALLED void begin_times(Packs x, Packs y) const {
    parallel_for_nowait(packs, Parts{m}, [&](int p, int k) { carry_.of(p, m)[k] = carried(p, k, x); });
    begin_transposed(y);
  }
  JAXSCP_CALLED void begin_transposed(Packs y) const {
    parallel_for(packs, Parts{m}, [&](int p, int k) { multiplier_.of(p, m)[k] = link_multiplier(y, p, k); });
  }
  Parts products() const { return {constraints() + primal.size}; }
  template <typename Row, typename Variable>
  void product(int p, int k, Packs x, Packs y, Row row, Variable variable) const {
    if (k < constraints()) constraint(p, k, of_primal(x, p), row);
    else transposed(p, k - constraints(), x, y, variable);
  }
  // Parts of the variables only.
  template <typename Variable>
  void transposed(int p, int j, Packs x, Packs y, Variable variable) const {
    variable(j, j < n ? hessian.times(p, j, of_primal(x, p)) : all(0.0), transposed(p, j, of_cones(y, p)));
  }

  // Multipliers of the links: zero cone for hard rows, tails of virtual control's cones for soft rows.
  Pack link_multiplier(Packs y, int p, int i) const {
    Entries v = of_cones(y, p);
    Pack s = soft.of(p, m)[i];
    return (1.0 - s) * v[zero + i] + s * v[virtual_ + 1 + i];
  }

  // Parts of a stage: half-spaces, second-order cones, rows of the zero cone and variables; ``count`` of each.
  Parts parts(int count = 1) const { return {r * count, cone_count * count, (m + primal.size) * count}; }

  // For part k of a stage, calls half_space(at), second_order(at, dimension, cone), zero_row(at) or variable(at), where
  // ``at`` is the part's position in a ConeVector, or a variable's position in a Primal.
  template <typename HalfSpace, typename SecondOrder, typename ZeroRow, typename Variable>
  void part(int k, HalfSpace half_space, SecondOrder second_order, ZeroRow zero_row, Variable variable) const {
    if (k < r) return half_space(k);
    k -= r;
    if (k < cone_count) return second_order(cone_at(k).offset, cone_at(k).dimension, k);
    k -= cone_count;
    if (k < m) return zero_row(zero + k);
    variable(k - m);
  }

  // Calls half_space(p, at) and second_order(p, at, dimension, cone) at every pack; ``at`` is as in ``part``.
  template <typename HalfSpace, typename SecondOrder>
  void each(HalfSpace half_space, SecondOrder second_order) const {
    parallel_for(packs, Parts{r, cone_count}, [&](int p, int k) {
      if (k < r) return half_space(p, k);
      Cone c = cone_at(k - r);
      second_order(p, c.offset, c.dimension, k - r);
    });
  }

  JAXSCP_CALLED void clear_zero_cone(Packs v) const {
    parallel_for(packs, Parts{m}, [&](int p, int i) { of_cones(v, p)[zero + i] = all(0.0); });
  }

  // v, or zero at stages beyond the end of the chain, whose numbers are undefined.
  Pack of_nodes(int p, Pack v) const { return where(within(p, nodes), v, all(0.0)); }
  Pack of_links(int p, Pack v) const { return where(within(p, nodes + 1), v, all(0.0)); }
  Pack of_stages(int p, int i, Shape shape, Pack v) const {
    return i < shape.of_node ? of_nodes(p, v) : of_links(p, v);
  }

  // Largest absolute entries of q and of b.
  using Largest = Totals<0, 2>;
  JAXSCP_CALLED Largest largest_of_vectors() const {
    return fold(packs, Parts{primal.size + cone.size}, Largest::none(), [&](int p, int k, Largest& found) {
      if (k < primal.size) return found.include_max(0, of_stages(p, k, primal, magnitude(of_primal(q, p)[k])));
      const int i = k - primal.size;
      found.include_max(1, of_stages(p, i, cone, magnitude(of_cones(b, p)[i])));
    });
  }

 private:
  JAXSCP_CALLED void read_matrices() {
    int size = 0;
    each_matrix([&](Matrix& matrix, MatrixSource) { size += matrix.size(); });
    parallel_for(size, [&](int at) {
      each_matrix([&](Matrix& matrix, MatrixSource from) {
        if (at >= 0 && at < matrix.size() && !matrix.read(nodes, packs, from, at)) changed = true;
        at -= matrix.size();
      });
    });
  }

  // Calls act(matrix, its source) for every matrix.
  template <typename Act>
  void each_matrix(Act act) {
    const ProgramData& g = data;
    act(hessian, {g.hessian, nullptr, n, n});
    act(after, {g.after, nullptr, m, n});
    act(before, {g.before + m * n, nullptr, m, n});
    act(rows, {g.row_matrix, nullptr, r, n});
    act(user, {nullptr, g.cones, u, n});
  }

  // Reads a ConeVector from arrays of half-spaces (``beyond`` past the end of the chain), user's cones and links. Hard
  // rows of links go to the zero cone, soft rows to virtual control's cone. All other entries are zero.
  JAXSCP_CALLED void gather_cones(const double* of_rows, double beyond, const double* ProgramData::ConeGroup::*of_cone,
                                  const double* of_links, Packs to) const {
    parallel_for(to.size, [&](int i) { to[i] = all(0.0); });
    gather(of_rows, nodes, r, to, 0, cone.size, beyond);
    int at = r;
    for (int c = 0; c < sizes.groups; ++c) {
      const int size = data.cones[c].rows;
      gather(data.cones[c].*of_cone, nodes, size, to, at, cone.size);
      at += size;
    }
    gather(of_links, nodes + 1, m, to, zero, cone.size);
    wait();
    parallel_for(packs, Parts{m}, [&](int p, int i) {
      Entries v = of_cones(to, p);
      Pack s = soft.of(p, m)[i], link = v[zero + i];
      v[zero + i] = (1.0 - s) * link;
      v[virtual_ + 1 + i] = s * link;
    });
  }

  int constraints() const { return r + u + m + n + 1; }

  // Contribution of a node to the link after it.
  Pack carried(int p, int i, Packs x) const { return of_nodes(p, before.times(p, i, of_primal(x, p))); }

  // Row k of A x: half-spaces, user's cones, links, arguments of the norm, bounds; v is x at the stage.
  template <typename Put>
  void constraint(int p, int k, Entries v, Put put) const {
    if (k < r) {
      put(k, rows.times(p, k, v));
    } else if (k < r + u) {
      put(k, user.times(p, k - r, v));
    } else if (k < r + u + m) {
      const int i = k - r - u;
      Pack from_before = one_before(p > 0 ? carry_.of(p - 1, m)[i] : all(0.0), carry_.of(p, m)[i]);
      Pack link = of_nodes(p, after.times(p, i, v)) + from_before, s = soft.of(p, m)[i];
      put(zero + i, (1.0 - s) * link);
      put(virtual_ + 1 + i, s * link);
    } else if (const int i = k - r - u - m; i < n) {
      if (has_norm) put(trust + 1 + i, -scale.of(p, n)[i] * v[i]);
    } else {
      put(virtual_, -v[zeta]);
      if (has_norm) put(trust, -v[xi]);
    }
  }

  // Entry j of A'y, with the links' multipliers from ``multiplier_``; v is y at the stage.
  Pack transposed(int p, int j, Entries v) const {
    if (j == xi) return has_norm ? -v[trust] : all(0.0);
    if (j == zeta) return -v[virtual_];
    Entries link = multiplier_.of(p, m), next = multiplier_.of(p + 1, m);
    const bool last = p + 1 == packs;
    Pack total = has_norm ? -scale.of(p, n)[j] * v[trust + 1 + j] : all(0.0);
    total = after.add_transposed(p, j, total, [&](int i) { return link[i]; });
    total = before.add_transposed(p, j, total, [&](int i) { return one_after(link[i], last ? all(0.0) : next[i]); });
    total = rows.add_transposed(p, j, total, [&](int i) { return v[i]; });
    return user.add_transposed(p, j, total, [&](int i) { return v[r + i]; });
  }

  Packs carry_, multiplier_;  // of links: contribution of the node before, and multipliers in a product
};

}  // namespace jaxscp
