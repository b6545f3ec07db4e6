// XLA FFI handler on a CPU: integrates the intervals of a batch, two packs at once, on XLA's threads.

#include <cstring>

#include "description.h"
#include "parallel_for.h"
#include "tangents.h"

namespace jaxscp {
namespace {

// Arrays from XLA, one row for each interval; ``intervals`` intervals of one element of the batch share parameters.
struct Arrays {
  const double *w, *parameters, *data, *multipliers;
  double *outputs, *jacobian, *hessian;
  int64_t count, intervals;
};

// Rows of the kLanes intervals that two packs hold.
class PackedIntervals {
 public:
  PackedIntervals(const Arrays& at, int64_t pack) : at_(at), begin_(pack * kLanes) {}

  // Transposes blocks of kWidth numbers of kWidth intervals: XLA stores intervals as rows, packs hold them as columns.
  void read(const double* from, int width, Wide* to) const {
    int i = 0;
    for (; i + kWidth <= width; i += kWidth)
      for (int half = 0; half < kLanes; half += kWidth) {
        Pack v[kWidth];
        for (int lane = 0; lane < kWidth; ++lane)
          std::memcpy(&v[lane], from + interval(half + lane) * width + i, sizeof v[lane]);
        transpose(v);
        for (int k = 0; k < kWidth; ++k) (half ? to[i + k].high : to[i + k].low) = v[k];
      }
    for (; i < width; ++i)
      for (int lane = 0; lane < kLanes; ++lane) set(to[i], lane, from[interval(lane) * width + i]);
  }

  void write(const Wide* from, int width, double* to) const {
    const int count = static_cast<int>(std::min<int64_t>(kLanes, at_.count - begin_));
    double* const first = to + begin_ * width;
    int i = 0;
    for (; i + kWidth <= width; i += kWidth)
      for (int half = 0; half < count; half += kWidth) {
        Pack v[kWidth];
        for (int k = 0; k < kWidth; ++k) v[k] = half ? from[i + k].high : from[i + k].low;
        transpose(v);
        for (int lane = 0; lane < std::min(kWidth, count - half); ++lane)
          std::memcpy(first + (half + lane) * width + i, &v[lane], sizeof v[lane]);
      }
    for (; i < width; ++i)
      for (int lane = 0; lane < count; ++lane) first[lane * width + i] = get(from[i], lane);
  }

  // Parameters of each interval, tape after tape; lanes beyond the last interval repeat those of the last.
  void read_parameters(const std::vector<TapeEvaluator*>& tapes, int width) const {
    for (int lane = 0; lane < kLanes; ++lane) {
      const double* from = at_.parameters + interval(lane) / at_.intervals * width;
      for (TapeEvaluator* tape : tapes)
        for (int i = 0; i < tape->parameter_count(); ++i) set(tape->parameters()[i], lane, *from++);
    }
  }

 private:
  int64_t interval(int lane) const { return std::min<int64_t>(begin_ + lane, at_.count - 1); }

  const Arrays& at_;
  int64_t begin_;
};

void integrate_pack(const IntervalProblem& p, const Arrays& at, int64_t pack, Workspace& workspace) {
  workspace.reset();
  Forward forward(p, workspace);
  Adjoint adjoint(p, forward, workspace);
  Tangents tangents(p, forward, adjoint, workspace);
  const PackedIntervals packed(at, pack);
  std::vector<TapeEvaluator*> tapes;
  auto note = [&](TapeEvaluator& tape) { tapes.push_back(&tape); };
  forward.tapes().for_all(note), tangents.tapes().for_all(note);
  int width = 0;
  for (TapeEvaluator* tape : tapes) width += tape->parameter_count();
  packed.read(at.w, p.inputs(), forward.w());
  packed.read(at.data, p.data(), forward.data());
  packed.read_parameters(tapes, width);
  forward.run();
  packed.write(forward.outputs(), p.outputs(), at.outputs);
  if (p.order == 0) return;
  if (p.order == 2) {
    packed.read(at.multipliers, p.outputs(), adjoint.multipliers());
    adjoint.run();
  }
  tangents.run();
  packed.write(tangents.outputs(), p.outputs() * p.inputs(), at.jacobian);
  if (p.order == 2) packed.write(tangents.hessian(), p.inputs() * p.inputs(), at.hessian);
}

void integrate(Call& call) {
  const IntervalProblem p =
      read_problem(call.numbers<int32_t>("integers").data(), call.numbers<double>("reals").data());
  if (p.stages() > kMaxStages) throw invalid("the Runge-Kutta method has too many stages");
  call.expect(p.order == 2 ? 4 : 3, 1 + p.order);
  auto argument = [&](int64_t i) { return call.argument(i).numbers<double>(); };
  auto result = [&](int64_t i) { return call.result(i).numbers<double>(); };
  const Array w = call.argument(0);
  Arrays at{};
  at.intervals = w.from_last(2), at.count = w.size() / p.inputs();
  at.w = argument(0), at.parameters = argument(1), at.data = argument(2), at.outputs = result(0);
  if (p.order > 0) at.jacobian = result(1);
  if (p.order > 1) at.multipliers = argument(3), at.hessian = result(2);
  const int64_t packs = (at.count + kLanes - 1) / kLanes;
  parallel_for(call, packs, [&](int64_t pack) {
    thread_local Workspace workspace;  // allocation takes half as long as the integration
    integrate_pack(p, at, pack, workspace);
  });
}

}  // namespace
}  // namespace jaxscp

JAXSCP_HANDLER(jaxscp_integrate, jaxscp::integrate);
