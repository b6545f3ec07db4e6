// Sparse matrices of all nodes, and the arrays that a program is read from.
#pragma once

#include "arena.h"
#include "parallel.h"

namespace jaxscp {

// Arrays of a program, row-major, with the chain as leading axis.
struct ProgramData {
  const double *hessian, *gradient, *before, *after, *link_offset, *soft, *penalty_weight, *row_matrix, *row_offset;
  struct ConeGroup {
    const double *matrix, *offset, *warm;  // ``warm``: multipliers of the warm start
    int rows;  // at a node
  } cones[kMaxGroups];
  const double *norm_weight, *norm_scale, *norm_centre;
  const double *warm_z, *warm_links, *warm_rows;  // warm start: variables and multipliers, or null
};

// Reads ``size`` numbers for each of ``count`` stages into packs; a stage has ``stride`` packs, and stages beyond
// ``count`` get the number ``beyond``. ``wait`` must follow, here and in ``scatter``.
JAXSCP_CALLED inline void gather(const double* from, int count, int size, Packs to, int offset, int stride,
                                 double beyond = 0.0) {
  parallel_for_nowait(to.size / stride, Parts{size}, [&](int p, int i) {
    for (int lane = 0; lane < kWidth; ++lane) {
      int k = p * kWidth + lane;
      set(to.of(p, stride)[offset + i], lane, k < count ? from[static_cast<long long>(k) * size + i] : beyond);
    }
  });
}

// Writes the packs of ``count`` stages, ``size`` numbers for each, to an array.
JAXSCP_CALLED inline void scatter(Packs from, int offset, int stride, int count, int size, double* to) {
  parallel_for_nowait(count, Parts{size}, [&](int k, int i) {
    to[k * size + i] = get(from.of(k / kWidth, stride)[offset + i], k % kWidth);
  });
}

// Source of a matrix: one array, or the arrays of the groups of cones.
struct MatrixSource {
  const double* array;
  const ProgramData::ConeGroup* cones;
  int rows, columns;

  // Numbers of one entry at all nodes.
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

// Sparse matrix at every node: entries that are zero at all nodes are left out.
class Matrix {
 public:
  Matrix(int rows, int columns, int packs, Arena& arena)
      : rows(rows), columns(columns), index_{arena.take_indices(rows + 1), arena.take_indices(rows * columns),
                                           arena.take_indices(columns + 1), arena.take_indices(rows * columns)},
        fast_index_(index_), number_(arena.take_indices(rows * columns)), fast_number_(number_),
        value_(arena.take(packs * rows * columns)) {}

  int size() const { return rows * columns; }

  // Reads one entry at all nodes. False if the sparsity differs from the last program's: then entries must be numbered
  // and read again.
  bool read(int nodes, int packs, MatrixSource from, int at) {
    const MatrixSource::Entry entry = from.entry(at / columns, at % columns);
    const bool known = entries >= 0, was_filled = known && number_[at] != kNone;
    const int e = was_filled ? number_[at] : 0;
    bool filled = false;
    for (int first = 0; first < packs; first += kAtOnce) {
      Pack v[kAtOnce];
#pragma unroll
      for (int k = 0; k < kAtOnce; ++k)  // all reads overlap
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
    number_[at] = filled ? 0 : kNone;
    return false;
  }

  // Numbers the nonzero entries.
  JAXSCP_CALLED void enumerate(FastIndices& fast) {
    list(index_.row_start, rows, columns, [&](int i, int j) { return i * columns + j; },
         [&](int e, int i, int j, int at) { index_.of_row[e] = pair_of(i, j), number_[at] = e; });
    list(index_.column_start, columns, rows, [&](int j, int i) { return i * columns + j; },
         [&](int f, int, int i, int at) { index_.of_column[f] = pair_of(i, number_[at] - index_.row_start[i]); });
    once([&] {
      entries = index_.row_start[rows];
      fast_index_.row_start = fast.take(index_.row_start, rows + 1);
      fast_index_.of_row = fast.take(index_.of_row, entries);
      fast_index_.column_start = fast.take(index_.column_start, columns + 1);
      fast_index_.of_column = fast.take(index_.of_column, entries);
    });
    fast.copy(index_.row_start, fast_index_.row_start, rows + 1), fast.copy(index_.of_row, fast_index_.of_row, entries);
    fast.copy(index_.column_start, fast_index_.column_start, columns + 1);
    fast.copy(index_.of_column, fast_index_.of_column, entries);
  }
  // Makes ``number`` fast.
  void copy_numbers(FastIndices& fast) {
    once([&] { fast_number_ = fast.take(number_, size()); });
    fast.copy(number_, fast_number_, size());
  }

  Entries at(int pack) const { return value_.of(pack, entries); }
  // Number of entry (i, j); negative if the entry is zero at all nodes.
  int number(int i, int j) const {
    const Index e = fast_number_[i * columns + j];
    return e == kNone ? -1 : e;
  }

  // Calls act(e, j) for every nonzero entry of row i, e being its number and j its column. On a GPU the loop is
  // unrolled twice: with more, all such loops together would outgrow the instruction cache.
  template <typename Act>
  void each_of_row(int i, Act act) const {
    const int end = fast_index_.row_start[i + 1];
#pragma unroll 2
    for (int e = fast_index_.row_start[i]; e < end; ++e) act(e, second_of(fast_index_.of_row[e]));
  }
  // Calls act(e, i) for every nonzero entry of column j, e being its number and i its row.
  template <typename Act>
  void each_of_column(int j, Act act) const {
    const int end = fast_index_.column_start[j + 1];
#pragma unroll 2
    for (int f = fast_index_.column_start[j]; f < end; ++f) {
      const int i = first_of(fast_index_.of_column[f]);
      act(fast_index_.row_start[i] + second_of(fast_index_.of_column[f]), i);
    }
  }
  // By a team, calls act(i, j, value) for every nonzero entry.
  template <typename Act>
  void each(int pack, Act act) const {
    Entries a = at(pack);
    in_team(entries, [&](int e) { act(first_of(fast_index_.of_row[e]), second_of(fast_index_.of_row[e]), a[e]); });
  }

  // Multiplies every entry by row(p, i) and column(p, j).
  template <typename Row, typename Column>
  void scale(int packs, Row row, Column column) {
    parallel_for(packs, Parts{entries}, [&](int p, int e) {
      Pack& v = at(p)[e];
      v = row(p, first_of(fast_index_.of_row[e])) * v * column(p, second_of(fast_index_.of_row[e]));
    });
  }

  // Row i times v.
  Pack times(int pack, int i, Entries v) const {
    Entries a = at(pack);
    Pack total = all(0.0);
    each_of_row(i, [&](int e, int j) { total += a[e] * v[j]; });
    return total;
  }
  // ``total`` + column j times v, with entries v(i).
  template <typename Vector>
  Pack add_transposed(int pack, int j, Pack total, Vector v) const {
    Entries a = at(pack);
    each_of_column(j, [&](int e, int i) { total += a[e] * v(i); });
    return total;
  }

  int rows, columns;
  int entries = -1;  // number of nonzero entries; negative before the first program

 private:
  static constexpr Index kNone = static_cast<Index>(-1);
  static constexpr int kAtOnce = (7 + kWidth) / kWidth;  // packs that are read together: at least eight numbers

  // Starts of rows and columns among the entries. ``of_row`` has (row, column) of each entry, ``of_column`` has (row,
  // number within the row), each pair in one integer to save shared memory.
  struct Indices {
    Index *row_start, *of_row, *column_start, *of_column;
  };
  static_assert(kMaxLines <= 1 << 15);

  // Numbers the nonzero entries line by line (rows or columns); entries of line i begin with begin[i].
  template <typename Position, typename Put>
  void list(Index* begin, int lines, int length, Position position, Put put) {
    parallel_for(lines, [&](int i) {
      int count = 0;
      for (int j = 0; j < length; ++j) count += number_[position(i, j)] != kNone;
      begin[i + 1] = count;
    });
    add_up(begin, lines);
    parallel_for(lines, [&](int i) {
      int number = begin[i];
      for (int j = 0; j < length; ++j)
        if (int at = position(i, j); number_[at] != kNone) put(number++, i, j, at);
    });
  }

  Indices index_, fast_index_;
  Index *number_, *fast_number_;  // number of each entry (i, j), or kNone
  Packs value_;
};

}  // namespace jaxscp
