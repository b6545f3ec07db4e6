// The Schur complement in the link multipliers: block tridiagonal, factored by cyclic reduction.
//
// Every second block is eliminated at once, which leaves a chain of half the length (``block_tridiagonal.py`` says it
// in JAX). Places beyond the last block hold unit blocks tied to nothing, so that they need no case of their own.
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
      level.packs = packs_for(count), level.odd_packs = packs_for(count / 2);
      level.vector = arena.take(level.packs * m * kSides);
      int eliminated = count > 1 ? level.odd_packs : 1;
      level.panels = arena.take(eliminated * 3 * m * m);
      level.reduced = arena.take(eliminated * 3 * m * kSides);
      if (count == 1) break;
      ++last_;
    }
    for (auto& b : blocks_) b = {arena.take(levels_[0].packs * m * m), arena.take(levels_[0].packs * m * m)};
    grams_ = arena.take(levels_[0].odd_packs * 3 * m * m);
  }

  int packs() const { return levels_[0].packs; }

  // The right sides, then the solutions: row i of side s at i * kSides + s of a pack.
  Packs vector() const { return levels_[0].vector; }

  // Blocks of the matrix, row-major: on the diagonal (lower triangles), and S_{l,l+1}, zero behind the last.
  Pack* diagonal(int p) { return &blocks_[0].diagonal[p * program_.m * program_.m]; }
  Pack* above(int p) { return &blocks_[0].above[p * program_.m * program_.m]; }

  JAXSCP_CALLED void factor() {
    const int m = program_.m;
    for (int l = 0; l < last_; ++l) reduce(blocks_[l % 2], levels_[l], blocks_[(l + 1) % 2], levels_[l + 1].packs);
    share_among_teams(1, [&](int) {
      Pack* panel = levels_[last_].panels.data;
      in_team(last_panel(program_).rows * m, [&](int at) { panel[at] = all(0.0); });
      in_team(m * m, [&](int at) {
        if (at % m <= at / m) entry(last_panel(program_), panel, at / m, at % m) = blocks_[last_ % 2].diagonal[at];
      });
      eliminate(last_panel(program_), panel);
    });
  }

  template <int S>
  JAXSCP_CALLED void solve() {
    const int m = program_.m;
    for (int l = 0; l < last_; ++l) descend_to<S>(levels_[l], levels_[l + 1]);
    Level& one = levels_[last_];
    share_among_teams(1, [&](int) {
      in_team(m * S, [&](int at) { one.reduced[at] = one.vector[at / S * kSides + at % S]; });
      descend<S>(last_panel(program_), one.panels.data, one.reduced.data, one.reduced.data);
      ascend<S>(last_panel(program_), one.panels.data, one.reduced.data);
      in_team(m * S, [&](int at) { one.vector[at / S * kSides + at % S] = one.reduced[at]; });
    });
    for (int l = last_ - 1; l >= 0; --l) ascend_from<S>(levels_[l], levels_[l + 1]);
  }

 private:
  static constexpr int kMaxLevels = 24;

  struct Blocks {
    Packs diagonal, above;
  };
  struct Level {
    int packs, odd_packs;
    Packs vector;
    Packs panels;   // of the odd blocks: D, and what ties it to the even blocks left and right of it
    Packs reduced;  // right sides of the odd blocks, eliminated
  };

  // One of a level's packs, of ``size`` entries each; behind the last, places whose entries are ``beyond``.
  static Pack at(Packs v, int packs, int p, int size, int entry, double beyond = 0.0) {
    return p < packs ? v[p * size + entry] : all(beyond);
  }

  JAXSCP_CALLED void reduce(Blocks from, const Level& level, Blocks to, int even_packs) {
    const int m = program_.m, size = m * m;
    share_among_teams(level.odd_packs, [&](int p) {
      Pack* panel = &level.panels[p * 3 * size];
      in_team(size, [&](int e) {
        int i = e / m, j = e % m;
        auto block = [&](Packs v, int q, double beyond) { return at(v, level.packs, q, size, e, beyond); };
        Pack first = block(from.above, 2 * p, 0.0), second = block(from.above, 2 * p + 1, 0.0);
        double unit = i == j ? 1.0 : 0.0;
        Pack even = block(from.diagonal, 2 * p, unit), odd = block(from.diagonal, 2 * p + 1, unit);
        if (j <= i) entry(link_panel(program_), panel, i, j) = odds(even, odd);
        entry(link_panel(program_), panel, m + i, j) = evens(first, second);     // S_{o-1,o}
        entry(link_panel(program_), panel, 2 * m + j, i) = odds(first, second);  // S_{o,o+1}'
      });
      eliminate(link_panel(program_), panel);
      grams(link_panel(program_), panel, &grams_[p * 3 * size]);
    });
    share_kept(even_packs, size, [&](int p, int e) {
      double unit = e / m == e % m ? 1.0 : 0.0;
      auto gram = [&](int q, int k) {
        return q >= 0 ? at(grams_, level.odd_packs, q, 3 * size, k * size + e) : all(0.0);
      };
      to.above[p * size + e] = -gram(p, 2);
      if (e % m > e / m) return;
      Pack diagonal = evens(at(from.diagonal, level.packs, 2 * p, size, e, unit),
                            at(from.diagonal, level.packs, 2 * p + 1, size, e, unit));
      to.diagonal[p * size + e] = diagonal - gram(p, 0) - one_before(gram(p - 1, 1), gram(p, 1));
    });
  }

  template <int S>
  JAXSCP_CALLED void descend_to(Level& from, Level& to) {
    const int m = program_.m, width = m * kSides;
    auto given = [&](int q, int e) { return at(from.vector, from.packs, q, width, e); };
    share_among_teams(from.odd_packs, [&](int p) {
      Pack* out = &from.reduced[p * 3 * m * kSides];
      in_team(m * S, [&](int k) {
        int e = k / S * kSides + k % S;
        out[k] = odds(given(2 * p, e), given(2 * p + 1, e));
      });
      descend<S>(link_panel(program_), &from.panels[p * 3 * m * m], out, out);
    });
    share_kept(to.packs, m * S, [&](int p, int k) {
      int i = k / S, s = k % S, e = i * kSides + s;
      auto out = [&](int q, int row) {
        return q >= 0 ? at(from.reduced, from.odd_packs, q, 3 * m * kSides, row * S + s) : all(0.0);
      };
      to.vector[p * width + e] = evens(given(2 * p, e), given(2 * p + 1, e)) - out(p, m + i) -
                                 one_before(out(p - 1, 2 * m + i), out(p, 2 * m + i));
    });
  }

  template <int S>
  JAXSCP_CALLED void ascend_from(Level& level, Level& even) {
    const int m = program_.m, width = m * kSides;
    auto solved = [&](int q, int e) { return at(even.vector, even.packs, q, width, e); };
    share_among_teams(level.odd_packs, [&](int p) {
      Pack* v = &level.reduced[p * 3 * m * kSides];
      in_team(m * S, [&](int k) {
        int e = k / S * kSides + k % S;
        v[m * S + k] = solved(p, e);
        v[2 * m * S + k] = one_after(solved(p, e), solved(p + 1, e));
      });
      ascend<S>(link_panel(program_), &level.panels[p * 3 * m * m], v);
    });
    share_kept(even.packs, m * S, [&](int p, int k) {
      int e = k / S * kSides + k % S;
      Pack x = solved(p, e), y = at(level.reduced, level.odd_packs, p, 3 * m * kSides, k);
      level.vector[2 * p * width + e] = first_of_pairs(x, y);
      if (2 * p + 1 < level.packs) level.vector[(2 * p + 1) * width + e] = last_of_pairs(x, y);
    });
  }

  const Program& program_;
  int last_ = 0;
  Level levels_[kMaxLevels];
  Blocks blocks_[2];  // of a level, and of the one it is reduced to
  Packs grams_;
};

}  // namespace jaxscp
