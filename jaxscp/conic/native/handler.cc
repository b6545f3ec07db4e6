// What XLA calls: solves a batch of programs of one shape, each to its own end, lanes shared among its threads.

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>

#include "interior_point.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace jaxscp {
namespace {

using Buffer = ffi::Buffer<ffi::F64>;
using Result = ffi::ResultBuffer<ffi::F64>;
using Integers = ffi::ResultBuffer<ffi::S64>;
using Flags = ffi::ResultBuffer<ffi::PRED>;

int64_t from_end(const Buffer& v, int axis) {
  auto d = v.dimensions();
  return d[d.size() - axis];
}

// ``work(lane)`` for every lane. The caller takes part, and waits only for helpers that have begun, so that a pool with
// no thread to spare cannot hold it up.
template <typename Work>
void share(ffi::ThreadPool& pool, int64_t lanes, const Work& work) {
  struct State {
    std::atomic<int64_t> next{0};
    std::mutex lock;
    std::condition_variable idle;
    int busy = 0;
    bool over = false;
  };
  auto state = std::make_shared<State>();
  auto take = [lanes](State& s, const Work& work) {
    for (int64_t lane; (lane = s.next++) < lanes;) work(lane);
  };
  for (int64_t i = 1; i < std::min<int64_t>(lanes, pool.num_threads()); ++i)
    pool.Schedule([state, take, &work] {
      {
        std::lock_guard<std::mutex> hold(state->lock);
        if (state->over) return;  // the caller has gone, and ``work`` with it
        ++state->busy;
      }
      take(*state, work);
      std::lock_guard<std::mutex> hold(state->lock);
      --state->busy;
      state->idle.notify_one();
    });
  take(*state, work);
  std::unique_lock<std::mutex> hold(state->lock);
  state->over = true;
  state->idle.wait(hold, [&] { return state->busy == 0; });
}

// A program's room and its solver's. Each thread keeps its last one: to find room anew takes longer than a step.
struct Worker {
  Sizes sizes;
  Settings settings;
  Program program;
  InteriorPoint solver;

  Worker(const Sizes& sizes, const Settings& settings)
      : sizes(sizes), settings(settings), program(sizes), solver(program, settings) {}

  static Worker& of_thread(const Sizes& sizes, const Settings& settings) {
    thread_local std::unique_ptr<Worker> kept;
    if (!kept || !(kept->sizes == sizes && kept->settings == settings)) kept = std::make_unique<Worker>(sizes, settings);
    return *kept;
  }
};

ffi::Error solve(ffi::ThreadPool pool, Buffer hessian, Buffer gradient, Buffer before, Buffer after, Buffer link_offset,
                 Buffer soft, Buffer link_weight, Buffer row_matrix, Buffer row_offset, Buffer cost_scale,
                 ffi::RemainingArgs others, Result z, Result xi, Result zeta, Result y_zero, Result y_orthant,
                 Result y_second, Result s_orthant, Result s_second, Result tau, Result kappa, Result error,
                 Result infeasibility, Result unboundedness, Integers iterations, Flags stalled, Flags broken,
                 double tolerance, double proof_tolerance, double loose_tolerance, double regularisation,
                 int64_t max_iterations, int64_t refinements, bool has_norm) {
  Settings settings{tolerance, proof_tolerance, loose_tolerance, regularisation, static_cast<int>(max_iterations),
                    static_cast<int>(refinements)};
  int N = from_end(gradient, 2), n = from_end(gradient, 1), m = from_end(soft, 1), r = from_end(row_offset, 1);
  Sizes sizes{N, n, m, r, {}, has_norm};
  int64_t lanes = cost_scale.element_count();
  std::vector<Buffer> more;
  for (size_t i = 0; i < others.size(); ++i) {
    auto v = others.get<Buffer>(i);
    if (!v.has_value()) return v.error();
    more.push_back(*v);
  }
  size_t groups = (more.size() - (has_norm ? 3 : 0)) / 2;
  for (size_t i = 0; i < groups; ++i)
    sizes.cones.push_back({static_cast<int>(from_end(more[2 * i + 1], 2)), static_cast<int>(from_end(more[2 * i + 1], 1))});
  int width = from_end(*y_second, 1), cones = from_end(*y_second, 2);

  auto given = [&](int64_t lane) {
    auto at = [&](const Buffer& v) { return v.typed_data() + lane * (v.element_count() / lanes); };
    Given g{at(hessian), at(gradient), at(before), at(after), at(link_offset), at(soft), at(link_weight),
            at(row_matrix), at(row_offset), {}};
    for (size_t i = 0; i < groups; ++i) g.cones.push_back({at(more[2 * i]), at(more[2 * i + 1])});
    if (has_norm) {
      g.norm_weight = at(more[2 * groups]), g.norm_scale = at(more[2 * groups + 1]);
      g.norm_centre = at(more[2 * groups + 2]);
    }
    return g;
  };
  // Second-order cones in the order of ``kkt._pack``: the user's groups, trust region, virtual control.
  auto put_cones = [&](const Program& p, const Packs& from, double* to) {
    std::fill_n(to, static_cast<int64_t>(cones) * width, 0.0);
    auto group = [&](int offset, ConeShape shape, int places) {
      for (int k = 0; k < places; ++k)
        for (int c = 0; c < shape.count; ++c, to += width)
          for (int i = 0; i < shape.dimension; ++i)
            to[i] = from[(k / kWidth) * p.cone.size + offset + c * shape.dimension + i][k % kWidth];
    };
    int offset = r;
    for (auto& c : sizes.cones) group(offset, c, N), offset += c.count * c.dimension;
    if (has_norm) group(p.trust, {1, 1 + n}, N);
    group(p.virtual_, {1, 1 + m}, N + 1);
  };

  share(pool, lanes, [&](int64_t lane) {
    Worker& worker = Worker::of_thread(sizes, settings);
    worker.program.read(given(lane));
    const Program& p = worker.program;
    InteriorPoint& solver = worker.solver;
    solver.run(cost_scale.typed_data()[lane]);

    const Iterate& v = solver.iterate();
    auto at = [&](Result& out) { return out->typed_data() + lane * (out->element_count() / lanes); };
    scatter(v.x, 0, p.primal.size, N, n, at(z));
    if (has_norm) scatter(v.x, p.xi, p.primal.size, N, 1, at(xi));
    scatter(v.x, p.zeta, p.primal.size, N + 1, 1, at(zeta));
    scatter(v.y, p.zero, p.cone.size, N + 1, m, at(y_zero));
    scatter(v.y, 0, p.cone.size, N, r, at(y_orthant));
    scatter(v.s, 0, p.cone.size, N, r, at(s_orthant));
    put_cones(p, v.y, at(y_second));
    put_cones(p, v.s, at(s_second));
    *at(tau) = v.tau, *at(kappa) = v.kappa, *at(error) = solver.residuals().error;
    *at(infeasibility) = solver.residuals().infeasibility, *at(unboundedness) = solver.residuals().unboundedness;
    iterations->typed_data()[lane] = solver.iterations;
    stalled->typed_data()[lane] = solver.stalled;
    broken->typed_data()[lane] = solver.broken;
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_interior_point, jaxscp::solve,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<jaxscp::Buffer>()   // hessian
                                  .Arg<jaxscp::Buffer>()   // gradient
                                  .Arg<jaxscp::Buffer>()   // before
                                  .Arg<jaxscp::Buffer>()   // after
                                  .Arg<jaxscp::Buffer>()   // offset of the links
                                  .Arg<jaxscp::Buffer>()   // soft
                                  .Arg<jaxscp::Buffer>()   // weight of the links
                                  .Arg<jaxscp::Buffer>()   // rows
                                  .Arg<jaxscp::Buffer>()   // their offset
                                  .Arg<jaxscp::Buffer>()   // unit of the cost
                                  .RemainingArgs()         // matrix, offset of each group of cones; the norm's three
                                  .Ret<jaxscp::Buffer>()   // z
                                  .Ret<jaxscp::Buffer>()   // xi
                                  .Ret<jaxscp::Buffer>()   // zeta
                                  .Ret<jaxscp::Buffer>()   // y
                                  .Ret<jaxscp::Buffer>()
                                  .Ret<jaxscp::Buffer>()
                                  .Ret<jaxscp::Buffer>()   // s
                                  .Ret<jaxscp::Buffer>()
                                  .Ret<jaxscp::Buffer>()   // tau
                                  .Ret<jaxscp::Buffer>()   // kappa
                                  .Ret<jaxscp::Buffer>()   // error
                                  .Ret<jaxscp::Buffer>()   // infeasibility
                                  .Ret<jaxscp::Buffer>()   // unboundedness
                                  .Ret<ffi::Buffer<ffi::S64>>()
                                  .Ret<ffi::Buffer<ffi::PRED>>()
                                  .Ret<ffi::Buffer<ffi::PRED>>()
                                  .Attr<double>("tolerance")
                                  .Attr<double>("proof_tolerance")
                                  .Attr<double>("loose_tolerance")
                                  .Attr<double>("regularisation")
                                  .Attr<int64_t>("max_iterations")
                                  .Attr<int64_t>("refinements")
                                  .Attr<bool>("has_norm"));
