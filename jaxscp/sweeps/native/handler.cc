// What XLA calls on a CPU: sweeps the intervals of a batch of flights, sixteen at once, shared among its threads.

#include "spread.h"
#include "sweep.h"

namespace jaxscp {
namespace {

template <typename T, typename Stored = T>
bool read(const ffi::Dictionary& attrs, const char* name, Several<T>& to) {
  auto found = attrs.get<ffi::Span<const Stored>>(name);
  if (!found.has_value()) return false;
  constexpr size_t each = sizeof(T) / sizeof(Stored);
  to = {reinterpret_cast<const T*>(found->begin()), static_cast<int>(found->size() / each)};
  return true;
}

bool read(const ffi::Dictionary& attrs, const char* name, int& to) {
  auto found = attrs.get<int64_t>(name);
  if (found.has_value()) to = static_cast<int>(*found);
  return found.has_value();
}

bool read(const ffi::Dictionary& attrs, Sweep& s) {
  int priced = 0;
  const bool all = read(attrs, "states", s.states) && read(attrs, "controls", s.controls) &&
                   read(attrs, "steps", s.steps) && read(attrs, "every", s.every) && read(attrs, "priced", priced) &&
                   read(attrs, "shares", s.shares) && read(attrs, "weights", s.weights) &&
                   read(attrs, "table", s.table) && read<Operation, int32_t>(attrs, "operations", s.operations) &&
                   read(attrs, "once", s.once) && read(attrs, "places", s.places) &&
                   read(attrs, "parameters", s.parameters) && read(attrs, "constants", s.constants) &&
                   read(attrs, "outputs", s.outputs) && read<Coordinates, int32_t>(attrs, "jacobian", s.jacobian) &&
                   read<Coordinates, int32_t>(attrs, "hessian", s.hessian) && read(attrs, "first", s.first);
  s.priced = priced;
  return all;
}

// The arrays that XLA passes, interval after interval; ``intervals`` of a flight share its parameters.
struct Arrays {
  const double *w, *parameters, *prices;
  double *path, *tangent, *curvature;
  int64_t count, intervals;
};

void sweep_pack(const Sweep& s, const Arrays& at, int64_t pack, SweepPack& here) {
  const int rows = s.extended(), columns = s.inputs();
  const int64_t begin = pack * kLanes;
  auto lane_of = [&](int lane) { return std::min<int64_t>(begin + lane, at.count - 1); };
  for (int lane = 0; lane < kLanes; ++lane) {
    const double* w = at.w + lane_of(lane) * columns;
    const double* parameters = at.parameters + lane_of(lane) / at.intervals * s.parameters;
    for (int i = 0; i < columns; ++i) set(here.w(i), lane, w[i]);
    for (int i = 0; i < s.parameters; ++i) set(here.parameter(i), lane, parameters[i]);
  }
  auto price = [&](int step, int stage, int row) {
    Wide p;
    for (int lane = 0; lane < kLanes; ++lane)
      set(p, lane, at.prices[((lane_of(lane) * s.steps + step) * s.stages() + stage) * rows + row]);
    return p;
  };
  const int lanes = static_cast<int>(std::min<int64_t>(kLanes, at.count - begin));
  auto keep = [&](int point) {
    for (int lane = 0; lane < lanes; ++lane) {
      const int64_t to = (begin + lane) * s.kept() + point;
      for (int i = 0; i < rows; ++i) at.path[to * rows + i] = get(here.path()[i], lane);
      for (int i = 0; i < rows * columns; ++i) at.tangent[to * rows * columns + i] = get(here.tangent()[i], lane);
    }
  };
  here.run(price, keep);
  if (!s.priced) return;
  for (int lane = 0; lane < lanes; ++lane)
    for (int i = 0; i < columns * columns; ++i)
      at.curvature[(begin + lane) * columns * columns + i] = get(here.curvature()[i], lane);
}

ffi::Error sweep(ffi::ThreadPool pool, ffi::RemainingArgs args, ffi::RemainingRets rets, ffi::Dictionary attrs) {
  Sweep s;
  if (!read(attrs, s)) return ffi::Error::InvalidArgument("the sweep lacks an attribute");
  if (s.stages() > kMaxStages) return ffi::Error::InvalidArgument("the Runge-Kutta method has too many stages");
  auto w = args.get<ffi::AnyBuffer>(0), parameters = args.get<ffi::AnyBuffer>(1);
  if (!w.has_value() || !parameters.has_value() || args.size() != (s.priced ? 3u : 2u) ||
      rets.size() != (s.priced ? 3u : 2u))
    return ffi::Error::InvalidArgument("the sweep lacks an array");
  const auto shape = w->dimensions();
  Arrays at{};
  at.w = w->typed_data<double>(), at.parameters = parameters->typed_data<double>();
  at.intervals = shape[shape.size() - 2], at.count = w->element_count() / s.inputs();
  if (s.priced) at.prices = args.get<ffi::AnyBuffer>(2)->typed_data<double>();
  at.path = (*rets.get<ffi::AnyBuffer>(0))->typed_data<double>();
  at.tangent = (*rets.get<ffi::AnyBuffer>(1))->typed_data<double>();
  if (s.priced) at.curvature = (*rets.get<ffi::AnyBuffer>(2))->typed_data<double>();
  const int64_t packs = (at.count + kLanes - 1) / kLanes;
  spread(pool, packs, [&](int64_t pack) {
    thread_local std::vector<Wide> memory;  // to find it anew takes as long as half a sweep
    SweepPack here(s, memory);
    sweep_pack(s, at, pack, here);
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_sweep, jaxscp::sweep,
                              xla::ffi::Ffi::Bind().Ctx<xla::ffi::ThreadPool>().RemainingArgs().RemainingRets().Attrs());
