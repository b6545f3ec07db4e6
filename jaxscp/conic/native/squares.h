// Contribution G' W^-2 G of half-spaces and of the user's cones to a node's Hessian.
#pragma once

#include "scaling.h"

namespace jaxscp {

// Weights of the rows G: of a half-space 1 / w^2; of a cone 1 / eta^2, negative in its first row. With the rank-one
// terms below, they make W^-2 = (2 J w w' J - J) / eta^2, J = diag(1, -1, .., -1).
inline void find_weights(const Program& g, const Scaling& s, int p, Entries weight) {
  const Entries w = g.of_cones(s.w, p);
  in_team(g.r, [&](int i) { weight[i] = inverse(w[i] * w[i]); });
  in_team(g.user_cones, [&](int c) {
    auto [offset, d, _] = g.cone_at(c);
    const Pack by = inverse(s.eta_of(p, c) * s.eta_of(p, c));
    for (int i = 0; i < d; ++i) weight[offset + i] = i == 0 ? -by : by;
  });
}

// Adds weight v v'.
template <typename Triangle>
void add_square(int n, Pack weight, const Pack* v, Triangle to) {
  in_team(n, [&](int i) {
    const Pack by = weight * v[i];
    for (int j = 0; j <= i; ++j) to(i, j) += by * v[j];
  });
}

}  // namespace jaxscp

#if defined(__CUDACC__)
#include "squares_by_warp.h"
#else
#include "squares_by_rows.h"
#endif
