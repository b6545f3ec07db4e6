// Sizes of a program, and the positions in its vectors that follow from them.
//
// A stage is a node with the link before it: link l belongs to node l, and the last stage is a link alone.
#pragma once

#include "pack.h"

namespace jaxscp {

// The number of stages is padded to a multiple of this: on a GPU, to whole warps.
#if defined(__CUDACC__)
constexpr int kStageMultiple = 32;
#else
constexpr int kStageMultiple = kWidth;
#endif

constexpr int kMaxGroups = 32;  // groups of cones
constexpr int kMaxCones = 256;  // cones of a node
constexpr int kMaxLines = 1 << 15;  // rows or columns of a matrix

struct ConeShape {
  int count, dimension;
  bool operator==(const ConeShape&) const = default;
};

// Sizes of a program: they determine the sizes of all arrays.
struct Sizes {
  int nodes, variables, link_rows, rows;
  bool has_norm;
  int groups;
  ConeShape cones[kMaxGroups];
  bool operator==(const Sizes&) const = default;
};

// A second-order cone's position in a ConeVector, and whether the cone belongs to the link.
struct Cone {
  int offset, dimension;
  bool of_link;
};

// Packs of a vector at each stage: the node's come first, then the link's.
struct Shape {
  int size, of_node;
};

// Layout of a Primal (z, xi, zeta), and of a ConeVector (rows, user's cones, trust region, zero cone, virtual control).
struct Layout {
  Sizes sizes;
  int nodes, n, m, r, u;  // variables, link rows, half-spaces, rows of the user's cones
  bool has_norm;
  int packs;
  Shape primal, cone;
  int xi, zeta, trust, zero, virtual_;  // offsets; z and rows begin at zero, the user's cones follow the rows
  // of a stage: first the user's cones, then the trust region's, if any, and virtual control's
  int cone_count, user_cones, trust_cone, virtual_cone;
  Cone cones[kMaxCones];
  double degree;  // number of complementarity pairs, with the pair (tau, kappa)

  constexpr explicit Layout(const Sizes& s)
      : sizes(s), nodes(s.nodes), n(s.variables), m(s.link_rows), r(s.rows), u(0), has_norm(s.has_norm),
        packs(packs_for(s.nodes + 1, kStageMultiple)), primal{n + 2, n + 1}, cone{}, xi(n), zeta(n + 1), trust(0),
        zero(0), virtual_(0), cone_count(0), user_cones(0), trust_cone(0), virtual_cone(0), cones{}, degree(0.0) {
    int at = r;
    for (int g = 0; g < s.groups; ++g)
      for (int i = 0; i < s.cones[g].count; ++i, at += s.cones[g].dimension)
        cones[cone_count++] = {at, s.cones[g].dimension, false};
    u = at - r, user_cones = cone_count;
    trust = at, trust_cone = cone_count;
    if (has_norm) cones[cone_count++] = {trust, 1 + n, false};
    zero = trust + (has_norm ? 1 + n : 0), virtual_ = zero + m, cone = {virtual_ + 1 + m, zero};
    virtual_cone = cone_count;
    cones[cone_count++] = {virtual_, 1 + m, true};
    degree = static_cast<double>(nodes) * (r + cone_count - 1) + (nodes + 1) + 1;
  }

  Cone cone_at(int c) const { return cones[c]; }
};

// On a GPU the kernel is compiled for the sizes, so that the layout is constant.
#if defined(__CUDACC__)
constexpr Layout kLayout(Sizes{JAXSCP_SIZES});

struct ProgramLayout {
  static constexpr int nodes = kLayout.nodes, n = kLayout.n, m = kLayout.m, r = kLayout.r, u = kLayout.u;
  static constexpr bool has_norm = kLayout.has_norm;
  static constexpr int packs = kLayout.packs;
  static constexpr Sizes sizes = kLayout.sizes;
  static constexpr Shape primal = kLayout.primal, cone = kLayout.cone;
  static constexpr int xi = kLayout.xi, zeta = kLayout.zeta, trust = kLayout.trust, zero = kLayout.zero;
  static constexpr int virtual_ = kLayout.virtual_, cone_count = kLayout.cone_count, user_cones = kLayout.user_cones;
  static constexpr int trust_cone = kLayout.trust_cone, virtual_cone = kLayout.virtual_cone;
  static constexpr double degree = kLayout.degree;

  explicit ProgramLayout(const Layout&) {}
  static Cone cone_at(int c) {
    constexpr int kFew = 8;  // up to here, selecting a cone is faster than reading it from memory
    if constexpr (cone_count > kFew) {
      return kLayout.cones[c];
    } else {
      Cone found = kLayout.cones[0];
#pragma unroll
      for (int k = 1; k < cone_count; ++k)
        if (c == k) found = kLayout.cones[k];
      return found;
    }
  }
};
#else
using ProgramLayout = Layout;
#endif

}  // namespace jaxscp
