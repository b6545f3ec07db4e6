// Ruiz's scales of a program (``conic/equilibrate.py`` has the mathematics), read once a round and never written.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <vector>

namespace jaxscp {

struct ConeMatrix {
  int count, dimension;  // of a node
  const double* matrix;
};

// Arrays as XLA passes them, row after row.
struct ProgramArrays {
  int nodes, variables, link_rows, rows;
  const double *hessian, *gradient, *before, *after, *soft, *row_matrix;
  const double* norm_weight;  // null where there is none
  std::vector<ConeMatrix> cones;
};

struct ScaleArrays {
  double *columns, *links, *rows;
  std::vector<double*> cones;
  double* cost;
};

class Ruiz {
 public:
  Ruiz(const ProgramArrays& program, const ScaleArrays& scales)
      : p_(program), s_(scales), columns_(p_.nodes * p_.variables), links_((p_.nodes + 1) * p_.link_rows),
        rows_(p_.nodes * p_.rows) {
    for (const ConeMatrix& cone : p_.cones) cones_.emplace_back(p_.nodes * cone.count);
  }

  void run(int rounds) {
    std::fill_n(s_.columns, columns_.size(), 1.0), std::fill_n(s_.links, links_.size(), 1.0);
    std::fill_n(s_.rows, rows_.size(), 1.0);
    for (size_t c = 0; c < cones_.size(); ++c) std::fill_n(s_.cones[c], cones_[c].size(), 1.0);
    *s_.cost = 1.0;
    for (int round = 0; round < rounds; ++round) {
      measure();
      refine();
    }
  }

 private:
  // Numbers that are not negative have the order of their bits: as integers a compiler finds the largest of many at
  // once, which it may not of numbers, any of which might be NaN.
  using Ordered = int64_t;

  static constexpr double kLowest = 1e-4, kHighest = 1e4, kEmpty = 1e-12;

  // Largest entries of the scaled program, by columns, rows and cones.
  void measure() {
    std::fill(columns_.begin(), columns_.end(), 0.0), std::fill(links_.begin(), links_.end(), 0.0);
    const int n = p_.variables, m = p_.link_rows;
    for (int k = 0; k < p_.nodes; ++k) {
      for (int i = 0; i < n; ++i) look(p_.hessian + (k * n + i) * n, k, *s_.cost * s_.columns[k * n + i]);
      for (int i = 0; i < m; ++i) {
        const int here = k * m + i, next = here + m;
        links_[here] = std::max(links_[here], look(p_.after + here * n, k, s_.links[here]));
        links_[next] = std::max(links_[next], look(p_.before + next * n, k, s_.links[next]));
      }
      for (int i = k * p_.rows; i < (k + 1) * p_.rows; ++i) rows_[i] = look(p_.row_matrix + i * n, k, s_.rows[i]);
      for (size_t c = 0; c < cones_.size(); ++c)
        for (int i = k * p_.cones[c].count; i < (k + 1) * p_.cones[c].count; ++i)
          cones_[c][i] = look_at_cone(p_.cones[c], i, k, s_.cones[c][i]);
    }
  }

  double look_at_cone(const ConeMatrix& cone, int which, int node, double scale) {
    const double* row = cone.matrix + which * cone.dimension * p_.variables;
    double largest = 0.0;
    for (int i = 0; i < cone.dimension; ++i, row += p_.variables) largest = std::max(largest, look(row, node, scale));
    return largest;
  }

  // The largest entry of a row, with its scale and those of the node's columns, whose own it may exceed.
  double look(const double* row, int node, double scale) {
    const int n = p_.variables;
    const double* __restrict column = s_.columns + node * n;
    double* __restrict largest = columns_.data() + node * n;
    Ordered found = 0;
    for (int j = 0; j < n; ++j) {
      const auto v = std::bit_cast<Ordered>(scale * std::fabs(row[j]) * column[j]);
      found = std::max(found, v);
      largest[j] = std::bit_cast<double>(std::max(v, std::bit_cast<Ordered>(largest[j])));
    }
    return std::bit_cast<double>(found);
  }

  void refine() {
    share_soft_rows();
    double largest = 0.0;
    for (size_t i = 0; i < columns_.size(); ++i) {
      const double by = shrink(columns_[i]);
      largest = std::max(largest, std::fabs(*s_.cost * s_.columns[i] * by * p_.gradient[i]));
      times(s_.columns[i], by);
    }
    for (int k = 0; p_.norm_weight && k < p_.nodes; ++k) largest = std::max(largest, *s_.cost * p_.norm_weight[k]);
    for (size_t i = 0; i < links_.size(); ++i) times(s_.links[i], shrink(links_[i]));
    for (size_t i = 0; i < rows_.size(); ++i) times(s_.rows[i], shrink(rows_[i]));
    for (size_t c = 0; c < cones_.size(); ++c)
      for (size_t i = 0; i < cones_[c].size(); ++i) times(s_.cones[c][i], shrink(cones_[c][i]));
    // A cost without linear terms gives no hint: to take it for a tiny one would blow up the prices of the links.
    *s_.cost /= largest > 0.0 ? std::clamp(largest, kLowest, kHighest) : 1.0;
  }

  // The soft rows of a link have one scale, by the largest of them.
  void share_soft_rows() {
    const int m = p_.link_rows;
    for (int l = 0; l <= p_.nodes; ++l) {
      double largest = 0.0;
      for (int i = l * m; i < (l + 1) * m; ++i) largest = std::max(largest, p_.soft[i] * links_[i]);
      for (int i = l * m; i < (l + 1) * m; ++i)
        if (p_.soft[i] > 0.0) links_[i] = largest;
    }
  }

  static double shrink(double size) { return size > kEmpty ? 1.0 / std::sqrt(size) : 1.0; }
  static void times(double& scale, double by) { scale = std::clamp(scale * by, kLowest, kHighest); }

  const ProgramArrays& p_;
  const ScaleArrays& s_;
  std::vector<double> columns_, links_, rows_;  // the largest entries
  std::vector<std::vector<double>> cones_;
};

}  // namespace jaxscp
