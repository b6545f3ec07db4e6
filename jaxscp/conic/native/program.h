// The equilibrated program in packs (``program.py`` and the head of ``kkt.py`` have the mathematics):
//
//     min 1/2 x'Px + q'x,   A x + s = b,   s in K,      x = (z, xi, zeta)
//
// A node's pack owns what the node itself adds to a vector, and what the link before it adds: link l is node l's.
#pragma once

#include <algorithm>
#include <cstdint>

#include "pack.h"

namespace jaxscp {

struct ConeShape {
  int count, dimension;
  bool operator==(const ConeShape&) const = default;
};

// All that the sizes of arrays follow from.
struct Sizes {
  int nodes, variables, link_rows, rows;
  std::vector<ConeShape> cones;
  bool has_norm;
  bool operator==(const Sizes&) const = default;
};

// What the program is made of, row-major, the chain first.
struct Given {
  const double *hessian, *gradient, *before, *after, *link_offset, *soft, *link_weight, *row_matrix, *row_offset;
  struct ConeGroup {
    const double *matrix, *offset;
  };
  std::vector<ConeGroup> cones;
  const double *norm_weight = nullptr, *norm_scale = nullptr, *norm_centre = nullptr;
};

// Takes entries of ``size`` numbers at each of the first ``count`` places into packs, ``stride`` packs an entry apart.
inline void gather(const double* from, int count, int size, Packs& to, int offset, int stride, double beyond = 0.0) {
  int packs = static_cast<int>(to.size()) / stride;
  for (int p = 0; p < packs; ++p)
    for (int i = 0; i < size; ++i) {
      Pack& v = to[static_cast<size_t>(p) * stride + offset + i];
      for (int lane = 0; lane < kWidth; ++lane) {
        int k = p * kWidth + lane;
        v[lane] = k < count ? from[static_cast<size_t>(k) * size + i] : beyond;
      }
    }
}

inline void scatter(const Packs& from, int offset, int stride, int count, int size, double* to) {
  for (int k = 0; k < count; ++k)
    for (int i = 0; i < size; ++i)
      to[static_cast<size_t>(k) * size + i] = from[static_cast<size_t>(k / kWidth) * stride + offset + i][k % kWidth];
}

// A matrix at every node, without the entries that are zero at all of them.
class Matrix {
 public:
  // ``stride``: numbers from one node's matrix to the next.
  void set(const double* from, int nodes, int packs, int rows, int columns, int64_t stride) {
    rows_ = rows;
    start.assign(1, 0);
    column.clear();
    for (int i = 0; i < rows; ++i) {
      for (int j = 0; j < columns; ++j) {
        bool filled = false;
        for (int k = 0; k < nodes && !filled; ++k) filled = from[k * stride + i * columns + j] != 0.0;
        if (filled) column.push_back(j);
      }
      start.push_back(static_cast<int>(column.size()));
    }
    entries = start.back();
    value.assign(static_cast<size_t>(packs) * entries, all(0.0));
    for (int i = 0; i < rows; ++i)
      for (int e = start[i]; e < start[i + 1]; ++e)
        for (int k = 0; k < nodes; ++k)
          value[static_cast<size_t>(k / kWidth) * entries + e][k % kWidth] = from[k * stride + i * columns + column[e]];
  }

  int rows() const { return rows_; }
  const Pack* at(int pack) const { return value.data() + static_cast<size_t>(pack) * entries; }

  // Row i times v.
  Pack times(int pack, int i, const Pack* v) const {
    const Pack* a = at(pack);
    Pack total = all(0.0);
    for (int e = start[i]; e < start[i + 1]; ++e) total += a[e] * v[column[e]];
    return total;
  }
  // out += row i times v
  void add_transposed(int pack, int i, Pack v, Pack* out) const {
    const Pack* a = at(pack);
    for (int e = start[i]; e < start[i + 1]; ++e) out[column[e]] += a[e] * v;
  }

  std::vector<int> start, column;  // of row i: entries start[i] .. start[i + 1] - 1
  int entries = 0;

 private:
  int rows_ = 0;
  Packs value;
};

// A second-order cone's place in a ConeVector.
struct Cone {
  int offset, dimension;
  bool of_link;
};

// How many packs a vector has of each eight places: those of a node first, then those of its link.
struct Shape {
  int size = 0, of_node = 0;
};

class Program {
 public:
  int nodes, packs, n, m, r, u;  // variables, link rows, half-spaces, rows of the user's cones
  Matrix hessian, after, before, rows, user;  // ``before``: E of the link after the node
  Packs soft, scale;
  std::vector<Mask> is_node, is_link;
  Shape primal, cone;                  // (z, xi, zeta) and (rows, user, trust, zero, virtual)
  int xi, zeta, trust, zero, virtual_;  // offsets; those of z and rows are zero, the user's cones follow the rows
  std::vector<Cone> cones;
  Packs q, b;
  double degree;  // number of complementarity pairs
  bool has_norm;

  explicit Program(const Sizes& sizes) : groups_(sizes.cones) {
    nodes = sizes.nodes, n = sizes.variables, m = sizes.link_rows, r = sizes.rows, has_norm = sizes.has_norm;
    packs = packs_for(nodes + 1);
    u = 0;
    for (auto& c : groups_) u += c.count * c.dimension;
    int t = has_norm ? 1 + n : 0;
    xi = n, zeta = n + 1, primal = {n + 2, n + 1};
    trust = r + u, zero = trust + t, virtual_ = zero + m, cone = {virtual_ + 1 + m, zero};
    int at = r;
    for (auto& c : groups_)
      for (int i = 0; i < c.count; ++i, at += c.dimension) cones.push_back({at, c.dimension, false});
    if (has_norm) cones.push_back({trust, t, false});
    cones.push_back({virtual_, 1 + m, true});
    degree = static_cast<double>(nodes) * r + (nodes + 1) + 1;  // the last: tau and kappa
    for (auto& c : cones) degree += c.of_link ? 0 : nodes;
    for (int p = 0; p < packs; ++p) {
      Pack place;
      for (int lane = 0; lane < kWidth; ++lane) place[lane] = p * kWidth + lane;
      is_node.push_back(place < all(nodes));
      is_link.push_back(place < all(nodes + 1));
    }
    scale.resize(packs * n), soft.resize(packs * m);
    q.resize(packs * primal.size), b.resize(packs * cone.size);
  }

  void read(const Given& g) {
    hessian.set(g.hessian, nodes, packs, n, n, n * n);
    after.set(g.after, nodes, packs, m, n, m * n);
    before.set(g.before + m * n, nodes, packs, m, n, m * n);
    rows.set(g.row_matrix, nodes, packs, r, n, r * n);
    std::vector<double> joined(static_cast<size_t>(nodes) * u * n);
    int at = 0;
    for (size_t i = 0; i < groups_.size(); ++i) {
      int size = groups_[i].count * groups_[i].dimension;
      for (int k = 0; k < nodes; ++k)
        std::copy_n(g.cones[i].matrix + static_cast<size_t>(k) * size * n, size * n, &joined[(static_cast<size_t>(k) * u + at) * n]);
      at += size;
    }
    user.set(joined.data(), nodes, packs, u, n, u * n);
    gather(g.soft, nodes + 1, m, soft, 0, m);

    std::fill(q.begin(), q.end(), all(0.0));
    std::fill(b.begin(), b.end(), all(0.0));
    gather(g.gradient, nodes, n, q, 0, primal.size);
    gather(g.link_weight, nodes + 1, 1, q, zeta, primal.size);
    gather(g.row_offset, nodes, r, b, 0, cone.size, 1.0);
    at = r;
    for (size_t i = 0; i < groups_.size(); ++i) {
      int size = groups_[i].count * groups_[i].dimension;
      gather(g.cones[i].offset, nodes, size, b, at, cone.size);
      at += size;
    }
    if (has_norm) {
      gather(g.norm_weight, nodes, 1, q, xi, primal.size);
      gather(g.norm_scale, nodes, n, scale, 0, n);
      gather(g.norm_centre, nodes, n, b, trust + 1, cone.size);
      for (int p = 0; p < packs; ++p)
        for (int i = 0; i < n; ++i) b[p * cone.size + trust + 1 + i] *= -scale[p * n + i];
    }
    gather(g.link_offset, nodes + 1, m, b, zero, cone.size);
    for (int p = 0; p < packs; ++p)
      for (int i = 0; i < m; ++i) {
        Pack v = soft[p * m + i], d = b[p * cone.size + zero + i];
        b[p * cone.size + zero + i] = (1.0 - v) * d;
        b[p * cone.size + virtual_ + 1 + i] = v * d;
      }
  }

  // E z_{l-1} + F z_l of every link, from z in a vector of ``stride`` packs.
  void links(const Packs& x, int stride, Packs& out) const {
    carry_.resize(packs * m);
    for (int p = 0; p < packs; ++p)
      for (int i = 0; i < m; ++i) carry_[p * m + i] = of_nodes(p, before.times(p, i, &x[p * stride]));
    for (int p = 0; p < packs; ++p)
      for (int i = 0; i < m; ++i) {
        Pack from_before = one_before(p > 0 ? carry_[(p - 1) * m + i] : all(0.0), carry_[p * m + i]);
        out[p * m + i] = of_nodes(p, after.times(p, i, &x[p * stride])) + from_before;
      }
  }

  // P x.
  void times_hessian(const Packs& x, Packs& out) const {
    for (int p = 0; p < packs; ++p) {
      for (int i = 0; i < n; ++i) out[p * primal.size + i] = hessian.times(p, i, &x[p * primal.size]);
      out[p * primal.size + xi] = out[p * primal.size + zeta] = all(0.0);
    }
  }

  // A x.
  void times_constraints(const Packs& x, Packs& out) const {
    link_.resize(packs * m);
    links(x, primal.size, link_);
    for (int p = 0; p < packs; ++p) {
      const Pack* v = &x[p * primal.size];
      Pack* o = &out[p * cone.size];
      for (int i = 0; i < r; ++i) o[i] = rows.times(p, i, v);
      for (int i = 0; i < u; ++i) o[r + i] = user.times(p, i, v);
      if (has_norm) {
        o[trust] = -v[xi];
        for (int i = 0; i < n; ++i) o[trust + 1 + i] = -scale[p * n + i] * v[i];
      }
      o[virtual_] = -v[zeta];
      for (int i = 0; i < m; ++i) {
        Pack s = soft[p * m + i], l = link_[p * m + i];
        o[zero + i] = (1.0 - s) * l;
        o[virtual_ + 1 + i] = s * l;
      }
    }
  }

  // Multipliers of the links: those of hard rows, and the tails of the virtual controls' cones.
  Pack link_multiplier(const Packs& y, int p, int i) const {
    const Pack* v = &y[p * cone.size];
    Pack s = soft[p * m + i];
    return (1.0 - s) * v[zero + i] + s * v[virtual_ + 1 + i];
  }

  // A' y.
  void times_constraints_transposed(const Packs& y, Packs& out) const {
    for (int p = 0; p < packs; ++p) {
      const Pack* v = &y[p * cone.size];
      Pack* o = &out[p * primal.size];
      for (int i = 0; i < n; ++i) o[i] = has_norm ? -scale[p * n + i] * v[trust + 1 + i] : all(0.0);
      for (int i = 0; i < m; ++i) {
        Pack here = link_multiplier(y, p, i);
        Pack next = p + 1 < packs ? link_multiplier(y, p + 1, i) : all(0.0);
        after.add_transposed(p, i, here, o);
        before.add_transposed(p, i, one_after(here, next), o);
      }
      for (int i = 0; i < r; ++i) rows.add_transposed(p, i, v[i], o);
      for (int i = 0; i < u; ++i) user.add_transposed(p, i, v[r + i], o);
      o[xi] = has_norm ? -v[trust] : all(0.0);
      o[zeta] = -v[virtual_];
    }
  }

  // Half-spaces and second-order cones of every pack: their places in a ConeVector, and a cone's among all.
  template <typename HalfSpace, typename SecondOrder>
  void each(HalfSpace half_space, SecondOrder second_order) const {
    for (int p = 0, c = 0; p < packs; ++p) {
      for (int i = 0; i < r; ++i) half_space(p * cone.size + i);
      for (auto& k : cones) second_order(p * cone.size + k.offset, k.dimension, c++);
    }
  }

  void clear_zero_cone(Packs& v) const {
    for (int p = 0; p < packs; ++p)
      for (int i = 0; i < m; ++i) v[p * cone.size + zero + i] = all(0.0);
  }

  // Of ``cones``, in each pack: the user's come first, then that of the trust region, if any, and the virtual control's.
  size_t virtual_cone() const { return cones.size() - 1; }
  size_t trust_cone() const { return cones.size() - 2; }
  size_t user_cones() const { return cones.size() - (has_norm ? 2 : 1); }

  // Places beyond the chain's end hold nothing that counts; what is carried to others or summed is taken from here.
  Pack of_nodes(int p, Pack v) const { return where(is_node[p], v, all(0.0)); }
  Pack of_links(int p, Pack v) const { return where(is_link[p], v, all(0.0)); }

  double dot(const Packs& a, const Packs& b, Shape shape) const {
    Pack total = all(0.0);
    for (int p = 0; p < packs; ++p) {
      const Pack *v = &a[p * shape.size], *w = &b[p * shape.size];
      total += of_nodes(p, jaxscp::dot(v, w, shape.of_node));
      total += of_links(p, jaxscp::dot(v + shape.of_node, w + shape.of_node, shape.size - shape.of_node));
    }
    return sum(total);
  }

  // The largest entry without its sign.
  double largest_of(const Packs& a, Shape shape) const {
    Pack most = all(0.0);
    for (int p = 0; p < packs; ++p)
      for (int i = 0; i < shape.size; ++i) {
        Pack v = magnitude(a[p * shape.size + i]);
        most = larger(i < shape.of_node ? of_nodes(p, v) : of_links(p, v), most);
      }
    return largest(most);
  }

 private:
  std::vector<ConeShape> groups_;
  mutable Packs carry_, link_;
};

}  // namespace jaxscp
