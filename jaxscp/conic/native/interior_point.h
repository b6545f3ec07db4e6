// The primal-dual interior point in the homogeneous embedding: the loop of ``interior_point.py``, step for step.
#pragma once

#include "newton_system.h"

namespace jaxscp {

struct Settings {
  double proof_tolerance, loose_tolerance, regularisation, refine_below;
  int max_iterations, refinements;
  bool operator==(const Settings&) const = default;
};

struct Iterate {
  Packs x, y, s;
  double tau = 1.0, kappa = 1.0;
  Iterate(const Program& p, Arena& arena)
      : x(arena.take(p.packs * p.primal.size)), y(arena.take(p.packs * p.cone.size)), s(arena.take(y.size)) {}
};

struct Residuals {
  Packs x, y;
  double tau = 0.0, mu = 0.0, error = 0.0, infeasibility = 0.0, unboundedness = 0.0;
  Residuals(const Program& p, Arena& arena)
      : x(arena.take(p.packs * p.primal.size)), y(arena.take(p.packs * p.cone.size)) {}
};

class InteriorPoint {
 public:
  InteriorPoint(const Program& program, const Settings& settings, Arena& arena)
      : program_(program), settings_(settings), system_(program, arena), scaling_(program, arena),
        iterate_(program, arena), next_(program, arena), affine_(program, arena), direction_(program, arena),
        constant_(program, arena), residuals_(program, arena), new_residuals_(program, arena) {
    point_ = arena.take(iterate_.y.size), square_ = arena.take(iterate_.y.size);
    target_ = arena.take(iterate_.y.size), lifted_ = arena.take(iterate_.y.size), ry_ = arena.take(iterate_.y.size);
    dual_ = arena.take(iterate_.x.size), hessian_x_ = arena.take(iterate_.x.size), rx_ = arena.take(iterate_.x.size);
    xi_ = arena.take(iterate_.x.size), gradient_ = arena.take(iterate_.x.size);
  }

  void run(double cost_scale, double tolerance) {
    double q = most(1.0, program_.largest_of(program_.q, program_.primal));
    double b = most(1.0, program_.largest_of(program_.b, program_.cone));
    once([&] {
      cost_scale_ = cost_scale, tolerance_ = tolerance, size_q_ = q, size_b_ = b;
      iterations = 0;
      started_ = stalled = broken = false;
    });
    work();
    dismiss();
  }

  // What is left to do of ``run``; other threads may come to help with it.
  void work() {
    while (admit()) {
      if (started_) step();
      else start();
      if (finished()) return;
    }
  }

  const Iterate& iterate() const { return iterate_; }
  const Residuals& residuals() const { return residuals_; }
  int iterations = 0;
  bool stalled = false, broken = false;

 private:
  bool finished() const {
    const Residuals& r = residuals_;
    return r.error <= tolerance_ || r.infeasibility <= settings_.proof_tolerance ||
           r.unboundedness <= settings_.proof_tolerance || stalled || broken || iterations >= settings_.max_iterations;
  }

  // Far from the end the digits that cones near their boundary take from a solution are not missed.
  int refinements() const {
    const Residuals& r = residuals_;
    return least(r.error, least(r.infeasibility, r.unboundedness)) < settings_.refine_below ? settings_.refinements : 0;
  }

  // The point that solves the program with its cones replaced by a least-squares penalty.
  JAXSCP_CALLED void start() {
    const Program& g = program_;
    scaling_.set_unit();
    system_.factor(scaling_, settings_.regularisation);
    share(rx_.size, [&](int i) { rx_[i] = -g.q[i]; });
    system_.solve<1>(scaling_, settings_.refinements, {{rx_, g.b, iterate_.x, iterate_.y}});
    share(iterate_.s.size, [&](int i) { iterate_.s[i] = -iterate_.y[i]; });
    g.clear_zero_cone(iterate_.s);
    lift_inside(iterate_.s);
    lift_inside(iterate_.y);
    // The bounds of the norms follow their cones, so that those rows start without residual.
    share(g.packs, [&](int p) {
      if (g.has_norm) g.of_primal(iterate_.x, p)[g.xi] = at(iterate_.s, p)[g.trust];
      g.of_primal(iterate_.x, p)[g.zeta] = at(iterate_.s, p)[g.virtual_];
    });
    once([&] { iterate_.tau = iterate_.kappa = 1.0; });
    measure(iterate_, residuals_);
    once([&] {
      started_ = true;
      broken = !is_finite(residuals_.error);
    });
  }

  // Move every cone's part at least one unit inside its cone.
  JAXSCP_CALLED void lift_inside(Packs v) const {
    program_.each([&](int p, int i) { at(v, p)[i] = larger(at(v, p)[i], all(1.0)); },
                  [&](int p, int i, int d, int) {
                    Entries part = at(v, p) + i;
                    part[0] = larger(part[0], soc::tail_norm(part, d) + 1.0);
                  });
  }

  void step() {
    const Program& g = program_;
    const Residuals& r = residuals_;
    const Iterate& old = iterate_;
    scaling_.set(old.s, old.y);
    scaling_.apply(old.y, point_);
    system_.factor(scaling_, settings_.regularisation);
    share(xi_.size, [&](int i) { xi_[i] = old.x[i] / old.tau; });
    g.times_hessian(xi_, gradient_);
    share(gradient_.size, [&](int i) { gradient_[i] = 2.0 * gradient_[i] + g.q[i]; });

    // the affine direction, and the constant one, which both steps share
    jordan(point_, point_, square_);
    right_side(1.0, square_);
    share(xi_.size, [&](int i) { dual_[i] = -g.q[i]; });
    const int rounds = refinements();
    system_.solve<2>(scaling_, rounds,
                     {{dual_, g.b, constant_.x, constant_.y}, {rx_, ry_, affine_.x, affine_.y}});
    double constant_slope = slope();
    once([&] { slope_ = constant_slope; });
    assemble(1.0, old.tau * old.kappa, affine_);
    double left = 1.0 - longest_step(old, affine_), sigma = left * left * left;

    // Mehrotra's combined direction: centring by sigma and second-order correction
    scaling_.apply_inverse(affine_.s, lifted_);
    scaling_.apply(affine_.y, target_);
    jordan(lifted_, target_, target_);
    share(target_.size, [&](int i) { target_[i] += square_[i]; });
    double centre = sigma * r.mu;
    g.each([&](int p, int i) { at(target_, p)[i] -= centre; },
           [&](int p, int i, int, int) { at(target_, p)[i] -= centre; });
    right_side(1.0 - sigma, target_);
    system_.solve<1>(scaling_, rounds, {{rx_, ry_, direction_.x, direction_.y}});
    assemble(1.0 - sigma, old.tau * old.kappa + affine_.tau * affine_.kappa - sigma * r.mu, direction_);
    take(0.99 * longest_step(old, direction_));
  }

  // Residuals reduced by ``part``, scaled complementarity moved by -target.
  JAXSCP_CALLED void right_side(double part, Packs target) {
    const Residuals& r = residuals_;
    program_.each([&](int p, int i) { at(ry_, p)[i] = at(target, p)[i] / at(point_, p)[i]; },
                  [&](int p, int i, int d, int) {
                    soc::divide(at(point_, p) + i, at(target, p) + i, d, at(ry_, p) + i);
                  });
    scaling_.apply(ry_, lifted_);
    share(rx_.size, [&](int i) { rx_[i] = -part * r.x[i]; });
    share(ry_.size, [&](int i) { ry_[i] = lifted_[i] - part * r.y[i]; });
  }

  // Add the multiple of the constant direction that the embedding's last equation asks for.
  JAXSCP_CALLED void assemble(double part, double target_tau, Iterate& out) {
    const Program& g = program_;
    double defect = -part * residuals_.tau + target_tau / iterate_.tau - g.dot(gradient_, out.x, g.primal) -
                    g.dot(g.b, out.y, g.cone);
    double tau = defect / slope_;
    share(out.x.size, [&](int i) { out.x[i] += tau * constant_.x[i]; });
    share(out.y.size, [&](int i) { out.y[i] += tau * constant_.y[i]; });
    scaling_.square(out.y, out.s);
    share(out.s.size, [&](int i) { out.s[i] = -(lifted_[i] + out.s[i]); });
    once([&] {
      out.tau = tau;
      out.kappa = -(target_tau + iterate_.kappa * tau) / iterate_.tau;
    });
  }

  // Derivative of the embedding's last equation along the constant direction; always negative.
  JAXSCP_CALLED double slope() {
    const Program& g = program_;
    share(dual_.size, [&](int i) { dual_[i] = constant_.x[i] - xi_[i]; });
    g.times_hessian(dual_, hessian_x_);
    scaling_.square(constant_.y, target_);
    return -(g.dot(dual_, hessian_x_, g.primal) + g.dot(constant_.y, target_, g.cone) + iterate_.kappa / iterate_.tau);
  }

  JAXSCP_CALLED void take(double length) {
    const Iterate &old = iterate_, &d = direction_;
    double tau = old.tau + length * d.tau, kappa = old.kappa + length * d.kappa, unit = 1.0 / most(tau, kappa);
    once([&] { next_.tau = unit * tau, next_.kappa = unit * kappa; });
    auto move = [&](Packs from, Packs along, Packs to) {
      share(to.size, [&](int i) { to[i] = unit * (from[i] + length * along[i]); });
    };
    move(old.x, d.x, next_.x), move(old.y, d.y, next_.y), move(old.s, d.s, next_.s);
    measure(next_, new_residuals_);
    once([&] {
      double error = new_residuals_.error, before = residuals_.error;
      broken = !(is_finite(error) && is_finite(new_residuals_.mu));
      // A step that makes a nearly solved iterate worse has run into rounding: keep the better one.
      stalled = length < 1e-6 || (before < settings_.loose_tolerance && error > 2.0 * before);
      if (!(broken || (stalled && error > before))) {
        swap(iterate_, next_);
        swap(residuals_, new_residuals_);
      }
      ++iterations;
    });
  }

  JAXSCP_CALLED void measure(const Iterate& v, Residuals& r) {
    const Program& g = program_;
    g.times_hessian(v.x, hessian_x_);
    g.times_constraints_transposed(v.y, dual_);
    g.times_constraints(v.x, r.y);
    share(r.y.size, [&](int i) { r.y[i] += v.s[i]; });
    double dual = g.largest_of(dual_, g.primal), primal = g.largest_of(r.y, g.cone);
    share(r.x.size, [&](int i) { r.x[i] = hessian_x_[i] + dual_[i] + v.tau * g.q[i]; });
    share(r.y.size, [&](int i) { r.y[i] -= v.tau * g.b[i]; });
    double quadratic = g.dot(v.x, hessian_x_, g.primal), linear = g.dot(g.q, v.x, g.primal);
    double offset = g.dot(g.b, v.y, g.cone);
    double mu = (g.dot(v.s, v.y, g.cone) + v.tau * v.kappa) / g.degree;

    double primal_cost = (0.5 * quadratic / v.tau + linear) / v.tau;
    double dual_cost = (-0.5 * quadratic / v.tau - offset) / v.tau;
    // The gap is judged in the user's unit of cost, the residuals in equilibrated units.
    double gap = fabs(primal_cost - dual_cost) / most(cost_scale_, least(fabs(primal_cost), fabs(dual_cost)));
    double primal_error = g.largest_of(r.y, g.cone) / (v.tau * size_b_);
    double dual_error = g.largest_of(r.x, g.primal) / (v.tau * size_q_);
    double curved = g.largest_of(hessian_x_, g.primal);
    once([&] {
      r.tau = linear + offset + v.kappa + quadratic / v.tau;
      r.mu = mu;
      r.error = most(gap, most(primal_error, dual_error));
      // a maximum leaves NaN out: sums do not
      if (!is_finite(gap) || !is_finite(mu)) r.error = sqrt(-1.0);  // not a number
      r.infeasibility = dual / most(-offset, soc::kTiny);
      r.unboundedness = most(curved, primal) / most(-linear, soc::kTiny);
    });
  }

  // a o b; zero on the zero cone
  JAXSCP_CALLED void jordan(Packs a, Packs b, Packs out) const {
    program_.clear_zero_cone(out);
    program_.each([&](int p, int i) { at(out, p)[i] = at(a, p)[i] * at(b, p)[i]; },
                  [&](int p, int i, int d, int) { soc::product(at(a, p) + i, at(b, p) + i, d, at(out, p) + i); });
  }

  // Largest step, at most one, that keeps the iterate in its cone.
  JAXSCP_CALLED double longest_step(const Iterate& from, const Iterate& along) const {
    const Program& g = program_;
    auto within = [&](Packs v, Packs d, double step) {
      return least_of(g.packs, g.r + g.cone_count, step, [&](int p, int k) {
        Pack one = all(1.0);
        if (k < g.r) {
          Pack from = at(v, p)[k], along = at(d, p)[k];
          return where(jaxscp::within(p, g.nodes), along < 0.0 ? -from / along : one, one);
        }
        auto [offset, dimension, of_link] = g.cone_at(k - g.r);
        Pack far = soc::step_to_boundary(at(v, p) + offset, at(d, p) + offset, dimension);
        return where(jaxscp::within(p, of_link ? g.nodes + 1 : g.nodes), far, one);
      });
    };
    double step = within(from.y, along.y, within(from.s, along.s, 1.0));
    if (along.tau < 0) step = least(step, -from.tau / along.tau);
    if (along.kappa < 0) step = least(step, -from.kappa / along.kappa);
    return step;
  }

  template <typename T>
  static void swap(T& a, T& b) {
    T kept = a;
    a = b;
    b = kept;
  }
  static double least(double a, double b) { return b < a ? b : a; }
  static double most(double a, double b) { return a < b ? b : a; }

  Entries at(Packs v, int p) const { return program_.of_cones(v, p); }

  const Program& program_;
  Settings settings_;
  NewtonSystem system_;
  Scaling scaling_;
  Iterate iterate_, next_, affine_, direction_, constant_;
  Residuals residuals_, new_residuals_;
  Packs point_, square_, target_, lifted_, ry_, dual_, hessian_x_, rx_, xi_, gradient_;
  double cost_scale_ = 1.0, tolerance_ = 0.0, size_q_ = 1.0, size_b_ = 1.0, slope_ = 0.0;
  bool started_ = false;
};

}  // namespace jaxscp
