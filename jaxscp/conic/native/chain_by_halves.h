// The Schur complement in the link multipliers, on a GPU: block tridiagonal, factored by cyclic reduction.
//
// Every second block is eliminated at once, which leaves a chain of half the length (``block_tridiagonal.py`` says it
// in JAX) and work for many threads.
#pragma once

#include "eliminations.h"
#include "program.h"

namespace jaxscp {

// Sides of a system that are solved together, at most.
constexpr int kSides = 2;

class Chain {
 public:
  Chain(const Program& program, Arena& arena) : program_(program) {
    const int m = program.m;
    for (int count = program.nodes + 1;; count -= count / 2) {
      Level& level = levels_[last_];
      level.blocks = count, level.odd = count / 2;
      level.vector = arena.take(level.blocks * m * kSides);
      int eliminated = count > 1 ? level.odd : 1;
      level.panels = arena.take(eliminated * 3 * m * m);
      level.reduced = arena.take(eliminated * 3 * m * kSides);
      if (count == 1) break;
      ++last_;
    }
    for (auto& b : blocks_) b = {arena.take(levels_[0].blocks * m * m), arena.take(levels_[0].blocks * m * m)};
    grams_ = arena.take(levels_[0].odd * 3 * m * m);
  }

  int packs() const { return levels_[0].blocks; }

  // Takes the matrix: diagonal(p, i, j) of its lower triangle, and above(p, i, j) of S_{l,l+1}, zero behind the last.
  template <typename Diagonal, typename Above>
  void read(Diagonal diagonal, Above above) {
    const int m = program_.m;
    share_kept(packs(), m * m, [&](int p, int e) {
      const int i = e / m, j = e % m;
      blocks_[0].above[p * m * m + e] = above(p, i, j);
      if (j <= i) blocks_[0].diagonal[p * m * m + e] = diagonal(p, i, j);
    });
  }

  JAXSCP_CALLED void factor() {
    const int m = program_.m;
    for (int l = 0; l < last_; ++l) reduce(blocks_[l % 2], levels_[l], blocks_[(l + 1) % 2], levels_[l + 1].blocks);
    share_among_teams(1, [&](int) {
      Pack* panel = levels_[last_].panels.data;  // with nothing below the block: one kind of panel less
      in_team(link_panel(program_).rows * m, [&](int at) { panel[at] = all(0.0); });
      in_team(m * m, [&](int at) {
        if (at % m <= at / m) entry(link_panel(program_), panel, at / m, at % m) = blocks_[last_ % 2].diagonal[at];
      });
      eliminate(link_panel(program_), panel);
    });
  }

  // For S right sides: right(p, i, s) gives row i of side s, and ``solution`` what is found.
  template <int S, typename Right>
  void solve(Right right) {
    const int m = program_.m;
    share_kept(packs(), m * S, [&](int p, int k) {
      levels_[0].vector[(p * m + k / S) * kSides + k % S] = right(p, k / S, k % S);
    });
    for (int l = 0; l < last_; ++l) descend_to<S>(levels_[l], levels_[l + 1]);
    Level& one = levels_[last_];
    share_among_teams(1, [&](int) {
      in_team(m * S, [&](int at) { one.reduced[at] = one.vector[at / S * kSides + at % S]; });
      descend<S>(link_panel(program_), one.panels.data, one.reduced.data, one.reduced.data);
      ascend<S>(link_panel(program_), one.panels.data, one.reduced.data);
      in_team(m * S, [&](int at) { one.vector[at / S * kSides + at % S] = one.reduced[at]; });
    });
    for (int l = last_ - 1; l >= 0; --l) ascend_from<S>(levels_[l], levels_[l + 1]);
  }

  // Row i of side s.
  Pack solution(int p, int i, int s) const { return levels_[0].vector[(p * program_.m + i) * kSides + s]; }

 private:
  static constexpr int kMaxLevels = 24;

  struct Blocks {
    Packs diagonal, above;
  };
  struct Level {
    int blocks, odd;  // how many, and how many of them have odd numbers and are eliminated
    Packs vector;
    Packs panels;   // of the odd blocks: D, and what ties it to the even blocks left and right of it
    Packs reduced;  // right sides of the odd blocks, eliminated
  };

  // Of a level's blocks, of ``size`` entries each; there is nothing before the first and behind the last.
  static Pack at(Packs v, int blocks, int p, int size, int entry) {
    return p >= 0 && p < blocks ? v[p * size + entry] : all(0.0);
  }

  JAXSCP_CALLED void reduce(Blocks from, const Level& level, Blocks to, int evens) {
    const int m = program_.m, size = m * m;
    share_among_teams(level.odd, [&](int p) {
      Pack* panel = &level.panels[p * 3 * size];
      in_team(size, [&](int e) {
        int i = e / m, j = e % m;
        const int even = 2 * p * size + e, odd = even + size;
        if (j <= i) entry(link_panel(program_), panel, i, j) = from.diagonal[odd];
        entry(link_panel(program_), panel, m + i, j) = from.above[even];     // S_{o-1,o}
        entry(link_panel(program_), panel, 2 * m + j, i) = from.above[odd];  // S_{o,o+1}'
      });
      eliminate(link_panel(program_), panel);
      grams(link_panel(program_), panel, &grams_[p * 3 * size]);
    });
    share_kept(evens, size, [&](int p, int e) {
      auto gram = [&](int q, int k) { return at(grams_, level.odd, q, 3 * size, k * size + e); };
      to.above[p * size + e] = -gram(p, 2);
      if (e % m <= e / m) to.diagonal[p * size + e] = from.diagonal[2 * p * size + e] - gram(p, 0) - gram(p - 1, 1);
    });
  }

  template <int S>
  JAXSCP_CALLED void descend_to(Level& from, Level& to) {
    const int m = program_.m, width = m * kSides;
    share_among_teams(from.odd, [&](int p) {
      Pack* out = &from.reduced[p * 3 * m * kSides];
      in_team(m * S, [&](int k) {
        int e = k / S * kSides + k % S;
        out[k] = from.vector[(2 * p + 1) * width + e];
      });
      descend<S>(link_panel(program_), &from.panels[p * 3 * m * m], out, out);
    });
    share_kept(to.blocks, m * S, [&](int p, int k) {
      int i = k / S, s = k % S, e = i * kSides + s;
      auto out = [&](int q, int row) { return at(from.reduced, from.odd, q, 3 * m * kSides, row * S + s); };
      to.vector[p * width + e] = from.vector[2 * p * width + e] - out(p, m + i) - out(p - 1, 2 * m + i);
    });
  }

  template <int S>
  JAXSCP_CALLED void ascend_from(Level& level, Level& even) {
    const int m = program_.m, width = m * kSides;
    auto solved = [&](int q, int e) { return at(even.vector, even.blocks, q, width, e); };
    share_among_teams(level.odd, [&](int p) {
      Pack* v = &level.reduced[p * 3 * m * kSides];
      in_team(m * S, [&](int k) {
        int e = k / S * kSides + k % S;
        v[m * S + k] = solved(p, e);
        v[2 * m * S + k] = solved(p + 1, e);
      });
      ascend<S>(link_panel(program_), &level.panels[p * 3 * m * m], v);
    });
    share_kept(even.blocks, m * S, [&](int p, int k) {
      int e = k / S * kSides + k % S;
      level.vector[2 * p * width + e] = solved(p, e);
      if (2 * p + 1 < level.blocks) level.vector[(2 * p + 1) * width + e] = level.reduced[p * 3 * m * kSides + k];
    });
  }

  const Program& program_;
  int last_ = 0;
  Level levels_[kMaxLevels];
  Blocks blocks_[2];  // of a level, and of the one it is reduced to
  Packs grams_;
};

}  // namespace jaxscp
