// What XLA calls on a CPU: sweeps the intervals of a batch of flights, two packs at once, shared among its threads.

#include <cstring>

#include "description.h"
#include "spread.h"
#include "tangents.h"

namespace jaxscp {
namespace {

// The arrays that XLA passes, interval after interval; ``intervals`` of a flight share its parameters.
struct Arrays {
  const double *w, *parameters, *data, *prices;
  double *outcomes, *jacobian, *curvature;
  int64_t count, intervals;
};

// Rows of two packs of intervals, from the first of them on.
class Lanes {
 public:
  Lanes(const Arrays& at, int64_t pack) : at_(at), begin_(pack * kLanes) {}

  // A pack of numbers of as many intervals at a time, which are rows in one place and columns in the other.
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
    const int lanes = static_cast<int>(std::min<int64_t>(kLanes, at_.count - begin_));
    double* const first = to + begin_ * width;
    int i = 0;
    for (; i + kWidth <= width; i += kWidth)
      for (int half = 0; half < lanes; half += kWidth) {
        Pack v[kWidth];
        for (int k = 0; k < kWidth; ++k) v[k] = half ? from[i + k].high : from[i + k].low;
        transpose(v);
        for (int lane = 0; lane < std::min(kWidth, lanes - half); ++lane)
          std::memcpy(first + (half + lane) * width + i, &v[lane], sizeof v[lane]);
      }
    for (; i < width; ++i)
      for (int lane = 0; lane < lanes; ++lane) first[lane * width + i] = get(from[i], lane);
  }

  // Parameters of a flight, tape after tape; the last interval's serve the lanes behind it too.
  void read_parameters(const std::vector<Player*>& tapes, int width) const {
    for (int lane = 0; lane < kLanes; ++lane) {
      const double* from = at_.parameters + interval(lane) / at_.intervals * width;
      for (Player* tape : tapes)
        for (int i = 0; i < tape->parameter_count(); ++i) set(tape->parameters()[i], lane, *from++);
    }
  }

 private:
  int64_t interval(int lane) const { return std::min<int64_t>(begin_ + lane, at_.count - 1); }

  const Arrays& at_;
  int64_t begin_;
};

void sweep_pack(const Sweep& s, const Arrays& at, int64_t pack, Memory& memory) {
  memory.again();
  Walk walk(s, memory);
  Prices prices(s, walk, memory);
  Tangents tangents(s, walk, prices, memory);
  const Lanes lanes(at, pack);
  std::vector<Player*> tapes;
  auto note = [&](Player& tape) { tapes.push_back(&tape); };
  walk.tapes().for_all(note), tangents.tapes().for_all(note);
  int width = 0;
  for (Player* tape : tapes) width += tape->parameter_count();
  lanes.read(at.w, s.inputs(), walk.w());
  lanes.read(at.data, s.data(), walk.data());
  lanes.read_parameters(tapes, width);
  walk.run();
  lanes.write(walk.outcomes(), s.outcomes(), at.outcomes);
  if (s.order == 0) return;
  if (s.order == 2) {
    lanes.read(at.prices, s.outcomes(), prices.outcomes());
    prices.run();
  }
  tangents.run();
  lanes.write(tangents.outcomes(), s.outcomes() * s.inputs(), at.jacobian);
  if (s.order == 2) lanes.write(tangents.curvature(), s.inputs() * s.inputs(), at.curvature);
}

ffi::Error sweep(ffi::ThreadPool pool, ffi::Span<const int32_t> whole, ffi::Span<const double> real,
                 ffi::RemainingArgs args, ffi::RemainingRets rets) {
  const Sweep s = described(whole.begin(), real.begin());
  if (s.stages() > kMaxStages) return ffi::Error::InvalidArgument("the Runge-Kutta method has too many stages");
  if (args.size() != (s.order == 2 ? 4u : 3u) || rets.size() != 1u + s.order)
    return ffi::Error::InvalidArgument("the sweep lacks an array");
  auto given = [&](size_t i) { return args.get<ffi::AnyBuffer>(i)->typed_data<double>(); };
  auto found = [&](size_t i) { return (*rets.get<ffi::AnyBuffer>(i))->typed_data<double>(); };
  const auto w = *args.get<ffi::AnyBuffer>(0);
  Arrays at{};
  at.intervals = w.dimensions()[w.dimensions().size() - 2], at.count = w.element_count() / s.inputs();
  at.w = given(0), at.parameters = given(1), at.data = given(2), at.outcomes = found(0);
  if (s.order > 0) at.jacobian = found(1);
  if (s.order > 1) at.prices = given(3), at.curvature = found(2);
  const int64_t packs = (at.count + kLanes - 1) / kLanes;
  spread(pool, packs, [&](int64_t pack) {
    thread_local Memory memory;  // to find it anew takes as long as half a sweep
    sweep_pack(s, at, pack, memory);
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_sweep, jaxscp::sweep,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Attr<xla::ffi::Span<const int32_t>>("whole")
                                  .Attr<xla::ffi::Span<const double>>("real")
                                  .RemainingArgs()
                                  .RemainingRets());
