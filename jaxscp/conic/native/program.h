// The program in packs (``program.py`` and the head of ``kkt.py`` have the mathematics):
//
//     min 1/2 x'Px + q'x,   A x + s = b,   s in K,      x = (z, xi, zeta)
//
// A node's pack owns what the node itself adds to a vector, and what the link before it adds: link l is node l's.
#pragma once

#include "arena.h"
#include "parallel.h"

namespace jaxscp {

// What the program is made of, row-major, the chain first.
struct ProgramData {
  const double *hessian, *gradient, *before, *after, *link_offset, *soft, *penalty_weight, *row_matrix, *row_offset;
  struct ConeGroup {
    const double *matrix, *offset, *warm;
    int rows;  // at a node
  } cones[kMaxGroups];
  const double *norm_weight, *norm_scale, *norm_centre;
  const double *warm_z, *warm_links, *warm_rows;  // where the solution is thought to be, if anywhere
};

// Takes entries of ``size`` numbers at each of the first ``count`` places into packs, ``stride`` packs an entry apart.
// Who needs them is to wait for it, here and where they are put back.
JAXSCP_CALLED inline void gather(const double* from, int count, int size, Packs to, int offset, int stride,
                                 double beyond = 0.0) {
  parallel_for_nowait(to.size / stride, Parts{size}, [&](int p, int i) {
    for (int lane = 0; lane < kWidth; ++lane) {
      int k = p * kWidth + lane;
      set(to.of(p, stride)[offset + i], lane, k < count ? from[static_cast<long long>(k) * size + i] : beyond);
    }
  });
}

JAXSCP_CALLED inline void scatter(Packs from, int offset, int stride, int count, int size, double* to) {
  parallel_for_nowait(count, Parts{size}, [&](int k, int i) {
    to[k * size + i] = get(from.of(k / kWidth, stride)[offset + i], k % kWidth);
  });
}

// Where a matrix is read from: in one array, or in those of groups of cones.
struct MatrixSource {
  const double* array;
  const ProgramData::ConeGroup* cones;
  int rows, columns;

  // Of an entry the number at each node.
  struct Entry {
    const double* first;
    long long stride;
    double operator()(int k) const { return first[k * stride]; }
  };
  Entry entry(int i, int j) const {
    if (!cones) return {array + i * columns + j, static_cast<long long>(rows) * columns};
    const ProgramData::ConeGroup* group = cones;
    for (; i >= group->rows; ++group) i -= group->rows;
    return {group->matrix + i * columns + j, static_cast<long long>(group->rows) * columns};
  }
};

// A matrix at every node, without the entries that are zero at all of them.
class Matrix {
 public:
  Matrix(int rows, int columns, int packs, Arena& arena)
      : rows(rows), columns(columns), index_{arena.take_integers(rows + 1), arena.take_integers(rows * columns),
                                           arena.take_integers(columns + 1), arena.take_integers(rows * columns)},
        fast_index_(index_), place_(arena.take_integers(rows * columns)), value_(arena.take(packs * rows * columns)) {}

  int size() const { return rows * columns; }

  // Takes an entry's numbers at all nodes. False where it is filled and was not in the last program, or the other way
  // round: entries are then to be numbered anew, and taken again.
  bool read(int nodes, int packs, MatrixSource from, int at) {
    const MatrixSource::Entry entry = from.entry(at / columns, at % columns);
    const bool known = entries >= 0, was_filled = known && place_[at] != kNone;
    const int e = was_filled ? place_[at] : 0;
    bool filled = false;
    for (int first = 0; first < packs; first += kAtOnce) {
      Pack v[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k)  // none of which waits for the one before
        for (int lane = 0; lane < kWidth; ++lane) {
          const int node = (first + k) * kWidth + lane;
          set(v[k], lane, node < nodes ? entry(node) : 0.0);
          filled |= get(v[k], lane) != 0.0;
        }
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k)
        if (was_filled && first + k < packs) this->at(first + k)[e] = v[k];
    }
    if (known && filled == was_filled) return true;
    place_[at] = filled ? 0 : kNone;
    return false;
  }

  // Numbers the filled entries.
  JAXSCP_CALLED void enumerate(FastIndices& warm) {
    list(index_.row_start, rows, columns, [&](int i, int j) { return i * columns + j; },
         [&](int e, int i, int j, int at) { index_.of_row[e] = pair(i, j), place_[at] = e; });
    list(index_.column_start, columns, rows, [&](int j, int i) { return i * columns + j; },
         [&](int f, int, int i, int at) { index_.of_column[f] = pair(i, place_[at] - index_.row_start[i]); });
    once([&] {
      entries = index_.row_start[rows];
      fast_index_.row_start = warm.take(index_.row_start, rows + 1), fast_index_.of_row = warm.take(index_.of_row, entries);
      fast_index_.column_start = warm.take(index_.column_start, columns + 1);
      fast_index_.of_column = warm.take(index_.of_column, entries);
    });
    warm.copy(index_.row_start, fast_index_.row_start, rows + 1), warm.copy(index_.of_row, fast_index_.of_row, entries);
    warm.copy(index_.column_start, fast_index_.column_start, columns + 1);
    warm.copy(index_.of_column, fast_index_.of_column, entries);
  }

  Entries at(int pack) const { return value_.of(pack, entries); }
  // Which entry of all (i, j) is; negative where it is zero at all nodes.
  int number(int i, int j) const { return place_[i * columns + j]; }

  // act(e, j) for every filled entry of row i: the e-th of all, in column j. On a GPU two at a time: with more, the code
  // of all that goes through rows and columns outgrows the instruction cache.
  template <typename Act>
  void each_of_row(int i, Act act) const {
    const int end = fast_index_.row_start[i + 1];
#pragma unroll 2
    for (int e = fast_index_.row_start[i]; e < end; ++e) act(e, second(fast_index_.of_row[e]));
  }
  // act(e, i) for every filled entry of column j: the e-th of all, in row i.
  template <typename Act>
  void each_of_column(int j, Act act) const {
    const int end = fast_index_.column_start[j + 1];
#pragma unroll 2
    for (int f = fast_index_.column_start[j]; f < end; ++f) {
      const int i = first(fast_index_.of_column[f]);
      act(fast_index_.row_start[i] + second(fast_index_.of_column[f]), i);
    }
  }
  // By a team, act(i, j, value) for every filled entry.
  template <typename Act>
  void each(int pack, Act act) const {
    Entries a = at(pack);
    in_team(entries, [&](int e) { act(first(fast_index_.of_row[e]), second(fast_index_.of_row[e]), a[e]); });
  }

  // Every entry is multiplied by row(p, i) and column(p, j).
  template <typename Row, typename Column>
  void scale(int packs, Row row, Column column) {
    parallel_for(packs, Parts{entries}, [&](int p, int e) {
      Pack& v = at(p)[e];
      v = row(p, first(fast_index_.of_row[e])) * v * column(p, second(fast_index_.of_row[e]));
    });
  }

  // Row i times v.
  Pack times(int pack, int i, Entries v) const {
    Entries a = at(pack);
    Pack total = all(0.0);
    each_of_row(i, [&](int e, int j) { total += a[e] * v[j]; });
    return total;
  }
  // ``total`` and column j times v, whose entries v(i) give.
  template <typename Vector>
  Pack add_transposed(int pack, int j, Pack total, Vector v) const {
    Entries a = at(pack);
    each_of_column(j, [&](int e, int i) { total += a[e] * v(i); });
    return total;
  }

  int rows, columns;
  int entries = -1;  // that are filled; before any are known, negative

 private:
  static constexpr int kNone = -1;
  static constexpr int kAtOnce = (7 + kWidth) / kWidth;  // packs that are read together: eight numbers

  // Where the lines' entries begin among all; and of each its row, with its column or its number in the row: in one
  // integer, so that there is room for them near by.
  struct Index {
    int *row_start, *of_row, *column_start, *of_column;
  };
  static_assert(kMaxLines <= 1 << 15);
  static int pair(int first, int second) { return first << 16 | second; }
  static int first(int pair) { return pair >> 16; }
  static int second(int pair) { return pair & 0xffff; }

  // Number the filled places by lines (rows or columns): line i's begin with begin[i].
  template <typename Place, typename Put>
  void list(int* begin, int lines, int length, Place place, Put put) {
    parallel_for(lines, [&](int i) {
      int count = 0;
      for (int j = 0; j < length; ++j) count += place_[place(i, j)] != kNone;
      begin[i + 1] = count;
    });
    add_up(begin, lines);
    parallel_for(lines, [&](int i) {
      int number = begin[i];
      for (int j = 0; j < length; ++j)
        if (int at = place(i, j); place_[at] != kNone) put(number++, i, j, at);
    });
  }

  Index index_, fast_index_;
  int* place_;  // of an entry among them all
  Packs value_;
};

class Program : public ProgramLayout {
 public:
  Matrix hessian, after, before, rows, user;  // ``before``: E of the link after the node
  Packs soft, scale;
  Packs q, b;
  ProgramData data;  // where it is to be read from
  bool changed = false;  // whether other entries of its matrices are filled than of the last program's

  Program(const Layout& layout, Arena& arena)
      : ProgramLayout(layout), hessian(n, n, packs, arena), after(m, n, packs, arena), before(m, n, packs, arena),
        rows(r, n, packs, arena), user(u, n, packs, arena), soft(arena.take(packs * m)), scale(arena.take(packs * n)),
        q(arena.take(packs * primal.size)), b(arena.take(packs * cone.size)), carry_(arena.take(packs * m)),
        multiplier_(arena.take(packs * m)) {}

  JAXSCP_CALLED void read() {
    const ProgramData& g = data;
    once([&] { changed = false; });
    read_matrices();
    if (changed) {
      FastIndices warm;
      each_matrix([&](Matrix& matrix, MatrixSource) { matrix.enumerate(warm); });
      read_matrices();
    }
    gather(g.soft, nodes + 1, m, soft, 0, m);

    parallel_for(q.size, [&](int i) { q[i] = all(0.0); });  // which waits for ``soft`` too
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

  // The point that is thought to be near: its variables without bounds of norms, and its multipliers with as much at the
  // heads of cones as the prices of these bounds ask for. The trust region's tail is not known, and taken for zero.
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

  // The entries at one place of a (z, xi, zeta), and of a ConeVector.
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

  // The same by parts, for who uses them at once: what neighbours have of each other, and then so many parts of a place.
  // Part k calls row(i, entry i of A x), for two rows where it is a link's, or variable(j, entry j of P x, and of A'y).
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
  // The parts of variables alone.
  template <typename Variable>
  void transposed(int p, int j, Packs x, Packs y, Variable variable) const {
    variable(j, j < n ? hessian.times(p, j, of_primal(x, p)) : all(0.0), transposed(p, j, of_cones(y, p)));
  }

  // Multipliers of the links: those of hard rows, and the tails of the virtual controls' cones.
  Pack link_multiplier(Packs y, int p, int i) const {
    Entries v = of_cones(y, p);
    Pack s = soft.of(p, m)[i];
    return (1.0 - s) * v[zero + i] + s * v[virtual_ + 1 + i];
  }

  // What a place has to do, whatever that is: one part for each of its half-spaces, second-order cones, rows of the
  // zero cone and variables.
  Parts parts(int sides = 1) const { return {r * sides, cone_count * sides, (m + primal.size) * sides}; }

  // Calls, for part k of a place, half_space(at), second_order(at, dimension, cone), zero_row(at) or variable(at):
  // ``at`` is where it begins in a ConeVector, and for a variable in a Primal.
  template <typename HalfSpace, typename SecondOrder, typename ZeroRow, typename Variable>
  void part(int k, HalfSpace half_space, SecondOrder second_order, ZeroRow zero_row, Variable variable) const {
    if (k < r) return half_space(k);
    k -= r;
    if (k < cone_count) return second_order(cone_at(k).offset, cone_at(k).dimension, k);
    k -= cone_count;
    if (k < m) return zero_row(zero + k);
    variable(k - m);
  }

  // Half-spaces and second-order cones of every pack: a place in its part of a ConeVector, and which of its cones.
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

  // Places beyond the chain's end hold nothing that counts; what is carried to others or summed is taken from here.
  Pack of_nodes(int p, Pack v) const { return where(within(p, nodes), v, all(0.0)); }
  Pack of_links(int p, Pack v) const { return where(within(p, nodes + 1), v, all(0.0)); }
  Pack of_stages(int p, int i, Shape shape, Pack v) const {
    return i < shape.of_node ? of_nodes(p, v) : of_links(p, v);
  }

  // The largest entries of q and of b, without their signs.
  using Largest = Totals<0, 2>;
  JAXSCP_CALLED Largest largest_of_vectors() const {
    return fold(packs, Parts{primal.size + cone.size}, Largest::none(), [&](int p, int k, Largest& found) {
      if (k < primal.size) return found.see(0, of_stages(p, k, primal, magnitude(of_primal(q, p)[k])));
      const int i = k - primal.size;
      found.see(1, of_stages(p, i, cone, magnitude(of_cones(b, p)[i])));
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

  // act(matrix, where it is read from)
  template <typename Act>
  void each_matrix(Act act) {
    const ProgramData& g = data;
    act(hessian, {g.hessian, nullptr, n, n});
    act(after, {g.after, nullptr, m, n});
    act(before, {g.before + m * n, nullptr, m, n});
    act(rows, {g.row_matrix, nullptr, r, n});
    act(user, {nullptr, g.cones, u, n});
  }

  // A ConeVector of numbers of half-spaces, which are ``beyond`` past the chain's end, of the user's cones, and of links:
  // those of hard rows are in the zero cone, of soft ones in the virtual control's. All else is zero.
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

  // What a node adds to the link after it.
  Pack carried(int p, int i, Packs x) const { return of_nodes(p, before.times(p, i, of_primal(x, p))); }

  // Row k of A x, of half-spaces, the user's cones, links and bounds with the norm's arguments; v is x.
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

  // Entry j of A'y, of whose links' multipliers ``multiplier_`` has those of links; v is y.
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

  Packs carry_, multiplier_;  // of links: what the node before adds, and what a product's links have
};

}  // namespace jaxscp
