// The primal-dual interior point in the homogeneous embedding: the loop of ``interior_point.py``, step for step.
#pragma once

#include <limits>

#include "newton_system.h"

namespace jaxscp {

struct Settings {
  double tolerance, proof_tolerance, loose_tolerance, regularisation;
  int max_iterations, refinements;
  bool operator==(const Settings&) const = default;
};

struct Iterate {
  Packs x, y, s;
  double tau = 1.0, kappa = 1.0;
  explicit Iterate(const Program& p)
      : x(p.packs * p.primal.size), y(p.packs * p.cone.size), s(p.packs * p.cone.size) {}
};

struct Residuals {
  Packs x, y;
  double tau = 0.0, mu = 0.0, error = 0.0, infeasibility = 0.0, unboundedness = 0.0;
  bool finite = false;
  explicit Residuals(const Program& p) : x(p.packs * p.primal.size), y(p.packs * p.cone.size) {}
};

class InteriorPoint {
 public:
  explicit InteriorPoint(const Program& program, const Settings& settings)
      : program_(program), settings_(settings), system_(program), scaling_(program), iterate_(program), next_(program),
        affine_(program), direction_(program), constant_(program), residuals_(program), new_residuals_(program),
        point_(iterate_.y), square_(point_), target_(point_), lifted_(point_), ry_(point_), dual_(iterate_.x),
        hessian_x_(dual_), rx_(dual_), xi_(dual_), gradient_(dual_) {}

  void run(double cost_scale) {
    cost_scale_ = cost_scale;
    size_q_ = std::max(1.0, program_.largest_of(program_.q, program_.primal));
    size_b_ = std::max(1.0, program_.largest_of(program_.b, program_.cone));
    start();
    measure(iterate_, residuals_);
    iterations = 0;
    stalled = false;
    broken = !std::isfinite(residuals_.error);
    while (!finished()) step();
  }

  const Iterate& iterate() const { return iterate_; }
  const Residuals& residuals() const { return residuals_; }
  int iterations = 0;
  bool stalled = false, broken = false;

 private:
  bool finished() const {
    const Residuals& r = residuals_;
    return r.error <= settings_.tolerance || r.infeasibility <= settings_.proof_tolerance ||
           r.unboundedness <= settings_.proof_tolerance || stalled || broken || iterations >= settings_.max_iterations;
  }

  // The point that solves the program with its cones replaced by a least-squares penalty.
  void start() {
    const Program& g = program_;
    scaling_.set_unit();
    system_.factor(scaling_, settings_.regularisation);
    for (size_t i = 0; i < rx_.size(); ++i) rx_[i] = -g.q[i];
    system_.solve<1>(scaling_, settings_.refinements, {{rx_, g.b, iterate_.x, iterate_.y}});
    for (size_t i = 0; i < iterate_.s.size(); ++i) iterate_.s[i] = -iterate_.y[i];
    g.clear_zero_cone(iterate_.s);
    lift_inside(iterate_.s);
    lift_inside(iterate_.y);
    // The bounds of the norms follow their cones, so that those rows start without residual.
    for (int p = 0; p < g.packs; ++p) {
      if (g.has_norm) iterate_.x[p * g.primal.size + g.xi] = iterate_.s[p * g.cone.size + g.trust];
      iterate_.x[p * g.primal.size + g.zeta] = iterate_.s[p * g.cone.size + g.virtual_];
    }
    iterate_.tau = iterate_.kappa = 1.0;
  }

  // Move every cone's part at least one unit inside its cone.
  void lift_inside(Packs& v) const {
    program_.each([&](int at) { v[at] = larger(v[at], all(1.0)); },
                  [&](int at, int d, int) { v[at] = larger(v[at], soc::tail_norm(&v[at], d) + 1.0); });
  }

  void step() {
    const Program& g = program_;
    const Residuals& r = residuals_;
    const Iterate& old = iterate_;
    scaling_.set(old.s, old.y);
    scaling_.apply(old.y, point_);
    system_.factor(scaling_, settings_.regularisation);
    for (size_t i = 0; i < xi_.size(); ++i) xi_[i] = old.x[i] / old.tau;
    g.times_hessian(xi_, gradient_);
    for (size_t i = 0; i < gradient_.size(); ++i) gradient_[i] = 2.0 * gradient_[i] + g.q[i];

    // the affine direction, and the constant one, which both steps share
    jordan(point_, point_, square_);
    right_side(1.0, square_);
    for (size_t i = 0; i < xi_.size(); ++i) dual_[i] = -g.q[i];
    system_.solve<2>(scaling_, settings_.refinements,
                     {{dual_, g.b, constant_.x, constant_.y}, {rx_, ry_, affine_.x, affine_.y}});
    slope_ = slope();
    assemble(1.0, old.tau * old.kappa, affine_);
    double sigma = std::pow(1.0 - longest_step(old, affine_), 3);

    // Mehrotra's combined direction: centring by sigma and second-order correction
    scaling_.apply_inverse(affine_.s, lifted_);
    scaling_.apply(affine_.y, target_);
    jordan(lifted_, target_, target_);
    for (size_t i = 0; i < target_.size(); ++i) target_[i] += square_[i];
    g.each([&](int at) { target_[at] -= sigma * r.mu; }, [&](int at, int, int) { target_[at] -= sigma * r.mu; });
    right_side(1.0 - sigma, target_);
    system_.solve<1>(scaling_, settings_.refinements, {{rx_, ry_, direction_.x, direction_.y}});
    assemble(1.0 - sigma, old.tau * old.kappa + affine_.tau * affine_.kappa - sigma * r.mu, direction_);
    take(0.99 * longest_step(old, direction_));
  }

  // Residuals reduced by ``share``, scaled complementarity moved by -target.
  void right_side(double share, const Packs& target) {
    const Residuals& r = residuals_;
    program_.each([&](int at) { ry_[at] = target[at] / point_[at]; },
                  [&](int at, int d, int) { soc::divide(&point_[at], &target[at], d, &ry_[at]); });
    scaling_.apply(ry_, lifted_);
    for (size_t i = 0; i < rx_.size(); ++i) rx_[i] = -share * r.x[i];
    for (size_t i = 0; i < ry_.size(); ++i) ry_[i] = lifted_[i] - share * r.y[i];
  }

  // Add the multiple of the constant direction that the embedding's last equation asks for.
  void assemble(double share, double target_tau, Iterate& out) {
    const Program& g = program_;
    double defect = -share * residuals_.tau + target_tau / iterate_.tau - g.dot(gradient_, out.x, g.primal) -
                    g.dot(g.b, out.y, g.cone);
    out.tau = defect / slope_;
    for (size_t i = 0; i < out.x.size(); ++i) out.x[i] += out.tau * constant_.x[i];
    for (size_t i = 0; i < out.y.size(); ++i) out.y[i] += out.tau * constant_.y[i];
    scaling_.square(out.y, out.s);
    for (size_t i = 0; i < out.s.size(); ++i) out.s[i] = -(lifted_[i] + out.s[i]);
    out.kappa = -(target_tau + iterate_.kappa * out.tau) / iterate_.tau;
  }

  // Derivative of the embedding's last equation along the constant direction; always negative.
  double slope() {
    const Program& g = program_;
    for (size_t i = 0; i < dual_.size(); ++i) dual_[i] = constant_.x[i] - xi_[i];
    g.times_hessian(dual_, hessian_x_);
    scaling_.square(constant_.y, target_);
    return -(g.dot(dual_, hessian_x_, g.primal) + g.dot(constant_.y, target_, g.cone) + iterate_.kappa / iterate_.tau);
  }

  void take(double length) {
    const Iterate &old = iterate_, &d = direction_;
    next_.tau = old.tau + length * d.tau;
    next_.kappa = old.kappa + length * d.kappa;
    double unit = 1.0 / std::max(next_.tau, next_.kappa);
    next_.tau *= unit, next_.kappa *= unit;
    auto move = [&](const Packs& from, const Packs& along, Packs& to) {
      for (size_t i = 0; i < to.size(); ++i) to[i] = unit * (from[i] + length * along[i]);
    };
    move(old.x, d.x, next_.x), move(old.y, d.y, next_.y), move(old.s, d.s, next_.s);
    measure(next_, new_residuals_);
    double error = new_residuals_.error, before = residuals_.error;
    broken = !(std::isfinite(error) && std::isfinite(new_residuals_.mu));
    // A step that makes a nearly solved iterate worse has run into rounding: keep the better one.
    stalled = length < 1e-6 || (before < settings_.loose_tolerance && error > 2.0 * before);
    if (!(broken || (stalled && error > before))) {
      std::swap(iterate_, next_);
      std::swap(residuals_, new_residuals_);
    }
    ++iterations;
  }

  void measure(const Iterate& v, Residuals& r) {
    const Program& g = program_;
    g.times_hessian(v.x, hessian_x_);
    g.times_constraints_transposed(v.y, dual_);
    g.times_constraints(v.x, r.y);
    for (size_t i = 0; i < r.y.size(); ++i) r.y[i] += v.s[i];
    double dual = g.largest_of(dual_, g.primal), primal = g.largest_of(r.y, g.cone);
    for (size_t i = 0; i < r.x.size(); ++i) r.x[i] = hessian_x_[i] + dual_[i] + v.tau * g.q[i];
    for (size_t i = 0; i < r.y.size(); ++i) r.y[i] -= v.tau * g.b[i];
    double quadratic = g.dot(v.x, hessian_x_, g.primal), linear = g.dot(g.q, v.x, g.primal);
    double offset = g.dot(g.b, v.y, g.cone);
    r.tau = linear + offset + v.kappa + quadratic / v.tau;
    r.mu = (g.dot(v.s, v.y, g.cone) + v.tau * v.kappa) / g.degree;

    double primal_cost = (0.5 * quadratic / v.tau + linear) / v.tau;
    double dual_cost = (-0.5 * quadratic / v.tau - offset) / v.tau;
    // The gap is judged in the user's unit of cost, the residuals in equilibrated units.
    double gap = std::abs(primal_cost - dual_cost) /
                 std::max(cost_scale_, std::min(std::abs(primal_cost), std::abs(dual_cost)));
    double primal_error = g.largest_of(r.y, g.cone) / (v.tau * size_b_);
    double dual_error = g.largest_of(r.x, g.primal) / (v.tau * size_q_);
    r.error = std::max(gap, std::max(primal_error, dual_error));
    // a maximum leaves NaN out: sums do not
    if (!std::isfinite(gap) || !std::isfinite(r.mu)) r.error = std::numeric_limits<double>::quiet_NaN();
    r.infeasibility = dual / std::max(-offset, soc::kTiny);
    r.unboundedness = std::max(g.largest_of(hessian_x_, g.primal), primal) / std::max(-linear, soc::kTiny);
  }

  // a o b; zero on the zero cone
  void jordan(const Packs& a, const Packs& b, Packs& out) const {
    program_.clear_zero_cone(out);
    program_.each([&](int at) { out[at] = a[at] * b[at]; },
                  [&](int at, int d, int) { soc::product(&a[at], &b[at], d, &out[at]); });
  }

  // Largest step, at most one, that keeps the iterate in its cone.
  double longest_step(const Iterate& from, const Iterate& along) const {
    Pack most = all(1.0);
    const Program& g = program_;
    auto within = [&](const Packs& v, const Packs& d) {
      for (int p = 0; p < g.packs; ++p) {
        int at = p * g.cone.size;
        Pack node = most, link = most;
        for (int i = 0; i < g.r; ++i)
          node = smaller(d[at + i] < 0.0 ? -v[at + i] / d[at + i] : all(1.0), node);
        for (auto& c : g.cones) {
          Pack& part = c.of_link ? link : node;
          part = smaller(soc::step_to_boundary(&v[at + c.offset], &d[at + c.offset], c.dimension), part);
        }
        most = where(g.is_node[p], smaller(node, most), most);
        most = where(g.is_link[p], smaller(link, most), most);
      }
    };
    within(from.s, along.s);
    within(from.y, along.y);
    double step = least(most);
    if (along.tau < 0) step = std::min(step, -from.tau / along.tau);
    if (along.kappa < 0) step = std::min(step, -from.kappa / along.kappa);
    return step;
  }

  const Program& program_;
  Settings settings_;
  NewtonSystem system_;
  Scaling scaling_;
  Iterate iterate_, next_, affine_, direction_, constant_;
  Residuals residuals_, new_residuals_;
  Packs point_, square_, target_, lifted_, ry_, dual_, hessian_x_, rx_, xi_, gradient_;
  double cost_scale_ = 1.0, size_q_ = 1.0, size_b_ = 1.0, slope_ = 0.0;
};

}  // namespace jaxscp
