// Elimination of the nodes' variables on a CPU. Each pack of nodes has a panel: the Hessian, and below it the
// coefficients of the two adjacent links.
#pragma once

#include "chain_from_ends.h"
#include "elimination.h"
#include "scaling.h"

namespace jaxscp {

class Nodes {
 public:
  Nodes(const Program& program, Arena& arena)
      : program_(program), shape_{program.n, program.n + 2 * program.m}, panel_(shape_.rows * shape_.size),
        gram_(program.m * program.m), panels_(arena.take(program.packs * panel_)),
        grams_(arena.take(program.packs * 3 * gram_)), right_(arena.take(program.packs * shape_.size * kMaxRhs)),
        found_(arena.take(program.packs * shape_.rows * kMaxRhs)) {}

  void read() {}

  // Eliminates the nodes and factors the Schur complement in the links. add(p, Triangle) adds up the lower triangle of
  // a node's Hessian. A link's own compliance is own(p, i) own(p, j), plus diagonal(p, i) on the diagonal.
  template <typename Add, typename Own, typename Diagonal>
  void factor(Chain& chain, const Scaling&, double, Add add, Own own, Diagonal diagonal) {
    const Program& g = program_;
    parallel_for_teams(g.packs, [&](int p) {
      Pack* panel = &panels_[p * panel_];
      std::fill_n(panel, panel_, all(0.0));
      add(p, Triangle{panel, shape_.size}, &right_[p * shape_.size * kMaxRhs]);
      Pack* below = panel + shape_.size * shape_.size;
      g.after.each(p, [&](int i, int j, Pack v) { below[i * shape_.size + j] = v; });
      g.before.each(p, [&](int i, int j, Pack v) { below[(g.m + i) * shape_.size + j] = v; });
      eliminate(shape_, panel);
      grams(shape_, panel, &grams_[p * 3 * gram_]);
    });
    auto gram = [&](int q, int k, int i, int j) {
      return q < 0 ? all(0.0) : g.of_nodes(q, grams_[(q * 3 + k) * gram_ + i * g.m + j]);
    };
    auto entry = [&](int p, int i, int j) {
      Pack compliance = own(p, i) * own(p, j) + (i == j ? diagonal(p, i) : all(0.0));
      Pack link = compliance + gram(p, 0, i, j) + one_before(gram(p - 1, 1, i, j), gram(p, 1, i, j));
      return where(within(p, g.nodes + 1), link, all(i == j ? 1.0 : 0.0));
    };
    chain.read(entry, [&](int p, int i, int j) { return gram(p, 2, i, j); });
    chain.factor();
  }

  // Row j of right-hand side s of a node.
  template <int S>
  Pack& right(int p, int j, int s) const {
    return right(p)[j * S + s];
  }

  // Solves for nodes and links; right-hand sides of links are link_rhs(p, i, s).
  template <int S, typename LinkRhs>
  void solve(Chain& chain, LinkRhs link_rhs) {
    const Program& g = program_;
    const int n = g.n, m = g.m;
    parallel_for_teams(g.packs, [&](int p) { descend<S>(shape_, &panels_[p * panel_], right(p), found(p)); });
    auto below = [&](int p, int i, int s) { return p < 0 ? all(0.0) : g.of_nodes(p, found(p)[(n + i) * S + s]); };
    chain.template solve<S>([&](int p, int i, int s) {
      Pack from_before = one_before(below(p - 1, m + i, s), below(p, m + i, s));
      return g.of_links(p, below(p, i, s) - link_rhs(p, i, s) + from_before);
    });
    parallel_for_teams(g.packs, [&](int p) {
      for (int k = 0; k < m * S; ++k) {
        Pack here = chain.solution(p, k / S, k % S);
        Pack next = p + 1 < g.packs ? chain.solution(p + 1, k / S, k % S) : all(0.0);
        found(p)[n * S + k] = here;
        found(p)[(n + m) * S + k] = one_after(here, next);
      }
      ascend<S>(shape_, &panels_[p * panel_], found(p));
    });
  }

  // Row j of solution s.
  template <int S>
  Pack solution(int p, int j, int s) const {
    return found(p)[j * S + s];
  }

 private:
  // Matrix stored by rows.
  struct Triangle {
    Pack* first;
    int size;
    Pack& operator()(int i, int j) const { return first[i * size + j]; }
  };

  // Right-hand sides and solutions, with those of one row adjacent.
  Entries right(int p) const { return right_.of(p, shape_.size * kMaxRhs); }
  Entries found(int p) const { return found_.of(p, shape_.rows * kMaxRhs); }

  const Program& program_;
  PanelShape shape_;
  int panel_, gram_;
  Packs panels_, grams_, right_, found_;
};

}  // namespace jaxscp
