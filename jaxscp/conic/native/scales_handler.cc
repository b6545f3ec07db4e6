// What XLA calls on a CPU for the scales of a batch of programs: a thread a lane.

#include "scales.h"
#include "spread.h"

namespace jaxscp {
namespace {

// The arrays of a call, by their number; those of a lane follow one another.
class Arrays {
 public:
  explicit Arrays(int64_t lanes) : lanes_(lanes) {}

  void add(const ffi::AnyBuffer& v) { all_.push_back(v); }
  size_t size() const { return all_.size(); }
  bool are_doubles() const {
    return std::all_of(all_.begin(), all_.end(), [](const auto& v) { return v.element_type() == ffi::F64; });
  }
  int axis(size_t which, size_t from_last) const {
    const auto shape = all_[which].dimensions();
    return static_cast<int>(shape[shape.size() - from_last]);
  }
  double* of(size_t which, int64_t lane) const {
    const ffi::AnyBuffer& v = all_[which];
    return static_cast<double*>(v.untyped_data()) + lane * (static_cast<int64_t>(v.element_count()) / lanes_);
  }

 private:
  int64_t lanes_;
  std::vector<ffi::AnyBuffer> all_;
};

constexpr size_t kBeforeCones = 6, kResultsBeforeCones = 3;

ffi::Error scales(ffi::ThreadPool pool, int64_t has_norm, int64_t rounds, ffi::RemainingArgs args,
                  ffi::RemainingRets rets) {
  const size_t first = kBeforeCones + (has_norm ? 1 : 0);
  if (args.size() < first || rets.size() != args.size() - first + kResultsBeforeCones + 1)
    return ffi::Error::InvalidArgument("the program lacks an array");
  const auto lanes = static_cast<int64_t>((*rets.get<ffi::AnyBuffer>(rets.size() - 1))->element_count());
  if (lanes == 0) return ffi::Error::Success();
  Arrays in(lanes), out(lanes);
  for (size_t i = 0; i < args.size(); ++i) in.add(*args.get<ffi::AnyBuffer>(i));
  if (!in.are_doubles()) return ffi::Error::InvalidArgument("the program is not of float64");
  for (size_t i = 0; i < rets.size(); ++i) out.add(**rets.get<ffi::AnyBuffer>(i));
  spread(pool, lanes, [&](int64_t lane) {
    ProgramArrays p{.nodes = in.axis(1, 2), .variables = in.axis(1, 1), .link_rows = in.axis(4, 1),
                    .rows = in.axis(5, 2), .hessian = in.of(0, lane), .gradient = in.of(1, lane),
                    .before = in.of(2, lane), .after = in.of(3, lane), .soft = in.of(4, lane),
                    .row_matrix = in.of(5, lane), .norm_weight = has_norm ? in.of(6, lane) : nullptr, .cones = {}};
    ScaleArrays s{.columns = out.of(0, lane), .links = out.of(1, lane), .rows = out.of(2, lane), .cones = {},
                  .cost = out.of(out.size() - 1, lane)};
    for (size_t c = first; c < in.size(); ++c) {
      p.cones.push_back({in.axis(c, 3), in.axis(c, 2), in.of(c, lane)});
      s.cones.push_back(out.of(kResultsBeforeCones + c - first, lane));
    }
    Ruiz(p, s).run(static_cast<int>(rounds));
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_scales, jaxscp::scales,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Attr<int64_t>("has_norm")
                                  .Attr<int64_t>("rounds")
                                  .RemainingArgs()
                                  .RemainingRets());
