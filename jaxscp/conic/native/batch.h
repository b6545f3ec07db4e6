// Batch of programs of one shape: arrays with the batch as leading axis.
#pragma once

#include "interior_point.h"

namespace jaxscp {

template <typename T>
struct BatchArray {
  T* data = nullptr;
  long long stride = 0;  // numbers from one batch element to the next
  T* of(long long element) const { return data + element * stride; }
};
using Input = BatchArray<const double>;
using Output = BatchArray<double>;

// Version of ``Batch``, which a handler passes to a kernel. Raise it with every change, as the two may differ in age.
constexpr long long kVersion = 7;

struct Batch {
  long long size;
  Settings settings;
  Input hessian, gradient, before, after, link_offset, soft, penalty_weight, row_matrix, row_offset, tolerance;
  Input cone_matrix[kMaxGroups], cone_offset[kMaxGroups];
  Input norm_weight, norm_scale, norm_centre;
  Input warm_z, warm_links, warm_rows, warm_cones[kMaxGroups];  // null without a warm start
  Output z, xi, zeta, y_zero, y_orthant, y_second, s_orthant, s_second, tau, kappa, error, infeasibility, unboundedness;
  int width;  // largest dimension of the second-order cones
  BatchArray<long long> iterations;
  BatchArray<bool> stalled, broken;
  Output scales_of_columns, scales_of_links, scales_of_rows, scales_of_cones[kMaxGroups], scale_of_cost;
};

inline ProgramData data(const Batch& v, const ProgramLayout& layout, long long element) {
  ProgramData g{v.hessian.of(element),    v.gradient.of(element),   v.before.of(element),      v.after.of(element),
          v.link_offset.of(element), v.soft.of(element),       v.penalty_weight.of(element), v.row_matrix.of(element),
          v.row_offset.of(element), {},                    v.norm_weight.of(element), v.norm_scale.of(element),
          v.norm_centre.of(element), v.warm_z.of(element),     v.warm_links.of(element),  v.warm_rows.of(element)};
  for (int c = 0; c < layout.sizes.groups; ++c)
    g.cones[c] = {v.cone_matrix[c].of(element), v.cone_offset[c].of(element), v.warm_cones[c].of(element),
                  layout.sizes.cones[c].count * layout.sizes.cones[c].dimension};
  return g;
}

// Writes second-order cones in the order of ``conic_form.pack_cones``: user's groups, trust region, virtual control.
inline void put_cones(const Program& p, Packs from, int width, double* to) {
  auto group = [&](int offset, ConeShape shape, int stages) {
    parallel_for_nowait(stages, Parts{shape.count * width}, [&](int k, int i) {
      const int cone = i / width, entry = i % width;
      double v = 0.0;
      if (entry < shape.dimension)
        v = get(p.of_cones(from, k / kWidth)[offset + cone * shape.dimension + entry], k % kWidth);
      to[k * shape.count * width + i] = v;
    });
    to += stages * shape.count * width;
  };
  int offset = p.r;
  for (int c = 0; c < p.sizes.groups; ++c) {
    group(offset, p.sizes.cones[c], p.nodes);
    offset += p.sizes.cones[c].count * p.sizes.cones[c].dimension;
  }
  if (p.has_norm) group(p.trust, {1, 1 + p.n}, p.nodes);
  group(p.virtual_, {1, 1 + p.m}, p.nodes + 1);
}

inline void put_scales(const Program& p, const Scales& from, const Batch& batch, long long element) {
  scatter(from.columns, 0, p.n, p.nodes, p.n, batch.scales_of_columns.of(element));
  scatter(from.links, 0, p.m, p.nodes + 1, p.m, batch.scales_of_links.of(element));
  scatter(from.rows, 0, p.r, p.nodes, p.r, batch.scales_of_rows.of(element));
  int offset = 0;
  for (int c = 0; c < p.sizes.groups; ++c) {
    const ConeShape group = p.sizes.cones[c];
    double* to = batch.scales_of_cones[c].of(element);
    parallel_for_nowait(p.nodes, Parts{group.count}, [&](int k, int i) {
      to[k * group.count + i] = get(from.user.of(k / kWidth, p.u)[offset + i * group.dimension], k % kWidth);
    });
    offset += group.count * group.dimension;
  }
  once([&] { *batch.scale_of_cost.of(element) = from.cost; });
}

inline void solve_element(const Batch& batch, long long element, Program& program, Scales& scales,
                          InteriorPoint& solver) {
  once([&] { program.data = data(batch, program, element); });
  program.read();
  scales.apply(batch.settings.equilibration);
  solver.run(*batch.tolerance.of(element));

  const Program& p = program;
  const Iterate& v = solver.iterate();
  scatter(v.x, 0, p.primal.size, p.nodes, p.n, batch.z.of(element));
  if (p.has_norm) scatter(v.x, p.xi, p.primal.size, p.nodes, 1, batch.xi.of(element));
  scatter(v.x, p.zeta, p.primal.size, p.nodes + 1, 1, batch.zeta.of(element));
  scatter(v.y, p.zero, p.cone.size, p.nodes + 1, p.m, batch.y_zero.of(element));
  scatter(v.y, 0, p.cone.size, p.nodes, p.r, batch.y_orthant.of(element));
  scatter(v.s, 0, p.cone.size, p.nodes, p.r, batch.s_orthant.of(element));
  put_cones(p, v.y, batch.width, batch.y_second.of(element));
  put_cones(p, v.s, batch.width, batch.s_second.of(element));
  put_scales(p, scales, batch, element);
  once([&] {
    *batch.tau.of(element) = v.tau, *batch.kappa.of(element) = v.kappa;
    const Residuals& r = solver.residuals();
    *batch.error.of(element) = r.error;
    *batch.infeasibility.of(element) = r.infeasibility, *batch.unboundedness.of(element) = r.unboundedness;
    *batch.iterations.of(element) = solver.iterations;
    *batch.stalled.of(element) = solver.stalled, *batch.broken.of(element) = solver.broken;
  });
}

}  // namespace jaxscp
