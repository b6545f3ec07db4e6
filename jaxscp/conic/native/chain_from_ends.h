// Schur complement in the link multipliers on a CPU: block tridiagonal, factored as L D L' from both ends to the
// middle.
//
// A register holds numbers of one column of one block. Elsewhere a register holds numbers of several stages; here only
// cyclic reduction would allow that, with three times the arithmetic. Each end can have its own thread.
#pragma once

#include <span>

#include "program.h"

namespace jaxscp {

// Largest number of right-hand sides that are solved together.
constexpr int kMaxRhs = 2;

class Chain {
 public:
  Chain(const Program& program, Arena& arena)
      : m_(program.m), links_(program.nodes + 1), middle_(links_ / 2), height_(packs_for(m_)), packs_(program.packs),
        panels_(arena.take(links_ * panel())), scaled_(arena.take(4 * panel())), inverse_(arena.take(links_ * height_)),
        transposed_(arena.take(links_ * height_ * kWidth)), vector_(arena.take(links_ * kMaxRhs * height_)),
        solution_(arena.take(packs_ * m_ * kMaxRhs)) {}

  // Reads the matrix: diagonal(p, i, j) in the lower triangle of S_{l,l}, and above(p, i, j) of S_{l,l+1}.
  template <typename Diagonal, typename Above>
  void read(Diagonal diagonal, Above above) {
    parallel_for(packs_, Parts{m_ * height_}, [&](int p, int k) {
      const int j = k / height_, h = k % height_;
      auto to = [&](int first) { return [=, this](int l) -> Pack& { return panel(l)[j * column() + first + h]; }; };
      if (h >= j / kWidth) to_links(p, h, 0, links_, [&](int i) { return diagonal(p, i, j); }, to(0));
      // the neighbour of a block is the next one towards the middle
      to_links(p, h, 0, middle_, [&](int i) { return above(p, j, i); }, to(height_));
      auto next = [&](int l) -> Pack& { return to(height_)(l + 1); };
      to_links(p, h, middle_, links_ - 1, [&](int i) { return above(p, i, j); }, next);
    });
  }

  void factor() {
    parallel_for_teams(2, [&](int end) {
      for (int t = 0; t < count(end); ++t) {
        const Neighbour before = eliminated(end, t - 1);
        eliminate(link(end, t), scaled(end, t), std::span(&before, t > 0));
      }
    });
    parallel_for_teams(1, [&](int) {
      Neighbour before[2];
      int many = 0;
      for (int end = 0; end < 2; ++end)
        if (count(end) > 0) before[many++] = eliminated(end, count(end) - 1);
      eliminate(middle_, scaled(0, count(0)), std::span(before, many));
    });
  }

  // Solves for S right-hand sides right(p, i, s), i being the row and s the side; see ``solution``.
  template <int S, typename Right>
  void solve(Right right) {
    parallel_for(packs_, Parts{height_ * S}, [&](int p, int k) {
      const int h = k / S, s = k % S;
      to_links(p, h, 0, links_, [&](int i) { return right(p, i, s); }, [&](int l) -> Pack& { return vector(l, s)[h]; });
    });
    parallel_for_teams(2, [&](int end) {
      for (int t = 0; t < count(end); ++t) {
        if (t > 0) take_from<S>(link(end, t - 1), link(end, t));
        descend<S>(link(end, t));
      }
    });
    parallel_for_teams(1, [&](int) {
      for (int end = 0; end < 2; ++end)
        if (count(end) > 0) take_from<S>(link(end, count(end) - 1), middle_);
      descend<S>(middle_);
      ascend<S>(middle_, -1);
    });
    parallel_for_teams(2, [&](int end) {
      for (int t = count(end) - 1, next = middle_; t >= 0; --t) ascend<S>(link(end, t), next), next = link(end, t);
    });
    parallel_for(packs_, Parts{height_ * S}, [&](int p, int k) {
      const int h = k / S, s = k % S;
      Pack v[kWidth];
      for (int lane = 0; lane < kWidth; ++lane) {
        const int l = p * kWidth + lane;
        v[lane] = l < links_ ? vector(l, s)[h] : all(0.0);
      }
      transpose(v);
      const int first = h * kWidth, end = std::min(m_, first + kWidth);
      for (int i = first; i < end; ++i) solution_[(p * m_ + i) * kMaxRhs + s] = v[i - first];
    });
  }

  // Row i of solution s.
  Pack solution(int p, int i, int s) const { return solution_[(p * m_ + i) * kMaxRhs + s]; }

 private:
  static constexpr int kColumns = std::min(4, kWidth);  // eliminated at once; their diagonal is in one pack

  // Packs of a panel's column: the block's own rows, then the rows of the block that is eliminated next.
  int column() const { return 2 * height_; }
  int panel() const { return m_ * column(); }

  // A block that is already eliminated: columns of L, and of L D.
  struct Neighbour {
    const Pack *unit, *scaled;
  };
  using Neighbours = std::span<const Neighbour>;

  // Number of blocks that are eliminated from an end (0 or 1), and the t-th of them.
  int count(int end) const { return end == 0 ? middle_ : links_ - 1 - middle_; }
  int link(int end, int t) const { return end == 0 ? t : links_ - 1 - t; }
  Neighbour eliminated(int end, int t) const {
    return t < 0 ? Neighbour{} : Neighbour{panel(link(end, t)), scaled(end, t)};
  }

  Pack* panel(int l) const { return &panels_[l * panel()]; }
  Pack* scaled(int end, int t) const { return &scaled_[(2 * end + t % 2) * panel()]; }
  Pack* vector(int l, int s) const { return &vector_[(l * kMaxRhs + s) * height_]; }

  static double* numbers(Pack* v) { return reinterpret_cast<double*>(v); }
  static const double* numbers(const Pack* v) { return reinterpret_cast<const double*>(v); }

  // Transposes rows (packs over stages) into packs over rows, and writes them to links begin .. end - 1.
  template <typename Rows, typename To>
  void to_links(int p, int h, int begin, int end, Rows rows, To to) {
    const int first = std::max(begin, p * kWidth), last = std::min(end, (p + 1) * kWidth);
    if (first >= last) return;
    Pack v[kWidth];
    for (int i = 0; i < kWidth; ++i) v[i] = h * kWidth + i < m_ ? rows(h * kWidth + i) : all(0.0);
    transpose(v);
    for (int l = first; l < last; ++l) to(l) = v[l % kWidth];
  }

  // to[c] -= sum over ``count`` columns of v, times number j + c of the same column of w.
  template <int C, int T>
  void subtract(Pack (&to)[C][T], const Pack* v, const Pack* w, int j, int count) const {
    for (int k = 0; k < count; ++k)
      for (int c = 0; c < C; ++c) {
        const double by = numbers(w + k * column())[j + c];
        for (int t = 0; t < T; ++t) to[c][t] -= v[k * column() + t] * by;
      }
  }

  // Columns j .. j + C - 1 after elimination of all columns before them, at packs h .. h + T - 1.
  template <int C, int T>
  void leave(Pack* unit, Pack* scaled, Neighbours before, int j, int h) const {
    Pack v[C][T];
    for (int c = 0; c < C; ++c)
      for (int t = 0; t < T; ++t) v[c][t] = unit[(j + c) * column() + h + t];
    if (h < height_)
      for (const Neighbour& from : before)
        subtract<C, T>(v, from.scaled + height_ + h, from.unit + height_, j, m_);
    subtract<C, T>(v, scaled + h, unit, j, j);
    for (int c = 0; c < C; ++c)
      for (int t = 0; t < T; ++t) scaled[(j + c) * column() + h + t] = v[c][t];
  }

  template <int C>
  void eliminate(Pack* unit, Pack* scaled, Pack* inverse, Neighbours before, int j) const {
    const int first = j / kWidth;
    for (int end : {height_, column()}) {
      int h = end == height_ ? first : height_;
      for (; h + 2 <= end; h += 2) leave<C, 2>(unit, scaled, before, j, h);
      if (h < end) leave<C, 1>(unit, scaled, before, j, h);
    }
    double v[C][C], l[C][C], over[C];  // the diagonal block, as numbers
    for (int c = 0; c < C; ++c)
      for (int i = c; i < C; ++i) {
        v[i][c] = numbers(scaled + (j + c) * column())[j + i];
        for (int k = 0; k < c; ++k) v[i][c] -= v[i][k] * l[c][k];
        if (i == c) numbers(inverse)[j + c] = over[c] = 1.0 / v[c][c];
        l[i][c] = v[i][c] * over[c];
      }
    for (int h = first; h < column(); ++h) {
      Pack x[C];
      for (int c = 0; c < C; ++c) {
        x[c] = scaled[(j + c) * column() + h];
        for (int k = 0; k < c; ++k) x[c] -= x[k] * l[c][k];
      }
      for (int c = 0; c < C; ++c) {
        if (h == first) x[c] = where(within(0, (j + c) % kWidth + 1), all(0.0), x[c]);  // below the diagonal
        scaled[(j + c) * column() + h] = x[c];
        unit[(j + c) * column() + h] = x[c] * over[c];
      }
    }
  }

  void eliminate(int l, Pack* scaled, Neighbours before) {
    Pack *unit = panel(l), *inverse = &inverse_[l * height_];
    int j = 0;
    for (; j + kColumns <= m_; j += kColumns) eliminate<kColumns>(unit, scaled, inverse, before, j);
    switch (m_ - j) {
      case 3: eliminate<3>(unit, scaled, inverse, before, j); break;
      case 2: eliminate<2>(unit, scaled, inverse, before, j); break;
      case 1: eliminate<1>(unit, scaled, inverse, before, j); break;
    }
    for (int h = 0; h < height_; ++h) {
      Pack v[kWidth];
      for (int k = 0; k < kWidth; ++k) v[k] = h * kWidth + k < m_ ? unit[(h * kWidth + k) * column() + h] : all(0.0);
      transpose(v);
      for (int k = 0; k < kWidth; ++k) transposed_[(l * height_ + h) * kWidth + k] = v[k];
    }
  }

  // Updates the right-hand sides of the next block with those of an eliminated one.
  template <int S>
  void take_from(int from, int to) {
    for (int h = 0; h < height_; ++h) {
      Pack v[S];
      for (int s = 0; s < S; ++s) v[s] = vector(to, s)[h];
      for (int k = 0; k < m_; ++k)
        for (int s = 0; s < S; ++s) v[s] -= panel(from)[k * column() + height_ + h] * numbers(vector(from, s))[k];
      for (int s = 0; s < S; ++s) vector(to, s)[h] = v[s];
    }
  }

  // v = L^-1 v
  template <int S>
  void descend(int l) {
    for (int h = 0; h < height_; ++h) {
      Pack v[S];
      for (int s = 0; s < S; ++s) v[s] = vector(l, s)[h];
      for (int k = 0; k < h * kWidth; ++k)
        for (int s = 0; s < S; ++s) v[s] -= panel(l)[k * column() + h] * numbers(vector(l, s))[k];
      const int end = std::min(kWidth, m_ - h * kWidth);
#pragma GCC unroll 8
      for (int k = 0; k < kWidth; ++k)
        if (k < end)
          for (int s = 0; s < S; ++s) v[s] -= panel(l)[(h * kWidth + k) * column() + h] * all(v[s][k]);
      for (int s = 0; s < S; ++s) vector(l, s)[h] = v[s];
    }
  }

  // v = L'^-1 (D^-1 v - K' v_next), K being the rows of L that belong to the next block.
  template <int S>
  void ascend(int l, int next) {
    for (int h = height_ - 1; h >= 0; --h) {
      Pack v[S];
      for (int s = 0; s < S; ++s) v[s] = vector(l, s)[h] * inverse_[l * height_ + h];
      const int end = std::min(kWidth, m_ - h * kWidth);
      for (int k = 0; k < end; ++k) {
        const Pack* w = panel(l) + (h * kWidth + k) * column();
        for (int s = 0; s < S; ++s) {
          Pack sum = all(0.0);
          for (int i = h + 1; i < height_; ++i) sum += w[i] * vector(l, s)[i];
          if (next >= 0)
            for (int i = 0; i < height_; ++i) sum += w[height_ + i] * vector(next, s)[i];
          set(v[s], k, get(v[s], k) - total(sum));
        }
      }
#pragma GCC unroll 8
      for (int k = kWidth - 1; k > 0; --k)
        for (int s = 0; s < S; ++s) v[s] -= transposed_[(l * height_ + h) * kWidth + k] * all(v[s][k]);
      for (int s = 0; s < S; ++s) vector(l, s)[h] = v[s];
    }
  }

  static double total(Pack v) {
    for (int half = kWidth / 2; half > 0; half /= 2)
      for (int i = 0; i < half; ++i) v[i] += v[i + half];
    return v[0];
  }

  int m_, links_, middle_, height_, packs_;
  Packs panels_;             // the matrix, later L below its diagonal
  Packs scaled_;             // L D of the last two blocks from each end
  Packs inverse_;            // D^-1
  Packs transposed_;         // diagonal blocks of L by rows, for substitution without sums across a register
  Packs vector_, solution_;  // by links, and by packs of stages
};

}  // namespace jaxscp
