// What XLA calls on a CPU: the nearest semidefinite matrices of a batch, a pack at once; its threads share the packs.

#include "eigen.h"
#include "spread.h"

namespace jaxscp {
namespace {

Memory& memory_of_thread() {
  thread_local Memory memory;
  memory.again();
  return memory;
}

// Of matrices number ``first`` to ``end``, at most a pack of ``size`` rows each.
void project(const double* from, int64_t first, int64_t end, int size, double* to, double* least) {
  const int64_t entries = static_cast<int64_t>(size) * size;
  const int lanes = static_cast<int>(end - first);
  Eigen eigen(size, memory_of_thread());
  for (int i = 0; i < size; ++i)
    for (int j = 0; j <= i; ++j) {
      Pack v = all(0.0);
      for (int lane = 0; lane < lanes; ++lane) {
        const double* matrix = from + (first + lane) * entries;
        set(v, lane, 0.5 * (matrix[i * size + j] + matrix[j * size + i]));
      }
      eigen.entry(i, j) = v;
    }
  eigen.run();
  Pack lowest = eigen.value(0);
  for (int k = 1; k < size; ++k) lowest = where(eigen.value(k) < lowest, eigen.value(k), lowest);
  for (int lane = 0; lane < lanes; ++lane) least[first + lane] = get(lowest, lane);
  for (int i = 0; i < size; ++i)
    for (int j = 0; j <= i; ++j) {
      Pack sum = all(0.0);
      for (int k = 0; k < size; ++k)
        sum += where(eigen.value(k) <= 0.0, all(0.0), eigen.value(k)) * eigen.vector(k)[i] * eigen.vector(k)[j];
      for (int lane = 0; lane < lanes; ++lane) {
        double* matrix = to + (first + lane) * entries;
        matrix[i * size + j] = matrix[j * size + i] = get(sum, lane);
      }
    }
}

ffi::Error nearest(ffi::ThreadPool pool, ffi::Buffer<ffi::F64> matrices, ffi::Result<ffi::Buffer<ffi::F64>> found,
                   ffi::Result<ffi::Buffer<ffi::F64>> least) {
  const auto shape = matrices.dimensions();
  const int size = static_cast<int>(shape[shape.size() - 1]);
  const auto count = static_cast<int64_t>(least->element_count());
  if (size == 0) return ffi::Error::InvalidArgument("matrices without rows have no eigenvalues");
  spread(pool, (count + kWidth - 1) / kWidth, [&](int64_t some) {
    const int64_t first = some * kWidth;
    project(matrices.typed_data(), first, std::min(count, first + kWidth), size, found->typed_data(),
            least->typed_data());
  });
  return ffi::Error::Success();
}

}  // namespace
}  // namespace jaxscp

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_nearest_semidefinite, jaxscp::nearest,
                              xla::ffi::Ffi::Bind()
                                  .Ctx<xla::ffi::ThreadPool>()
                                  .Arg<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>()
                                  .Ret<xla::ffi::Buffer<xla::ffi::F64>>());
