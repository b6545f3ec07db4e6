// XLA FFI handlers on a CPU: eigenvalues and vectors of a batch of matrices, and the nearest semidefinite matrices, a
// pack of matrices at once on XLA's threads.

#include "eigen.h"
#include "parallel_for.h"

namespace jaxscp {
namespace {

Workspace& workspace_of_thread() {
  thread_local Workspace workspace;
  workspace.reset();
  return workspace;
}

// Eigenvalues and vectors of matrices ``first`` to ``end``, at most a pack of them.
Eigen eigen_of(const double* from, int64_t first, int64_t end, int size) {
  const int64_t entries = static_cast<int64_t>(size) * size;
  Eigen eigen(size, workspace_of_thread());
  for (int i = 0; i < size; ++i)
    for (int j = 0; j <= i; ++j) {
      Pack v = all(0.0);
      for (int lane = 0; lane < end - first; ++lane) {
        const double* matrix = from + (first + lane) * entries;
        set(v, lane, 0.5 * (matrix[i * size + j] + matrix[j * size + i]));
      }
      eigen.entry(i, j) = v;
    }
  eigen.run();
  return eigen;
}

void project(const double* from, int64_t first, int64_t end, int size, double* to, double* least) {
  const int64_t entries = static_cast<int64_t>(size) * size;
  const Eigen eigen = eigen_of(from, first, end, size);
  Pack lowest = eigen.value(0);
  for (int k = 1; k < size; ++k) lowest = where(eigen.value(k) < lowest, eigen.value(k), lowest);
  for (int64_t lane = 0; lane < end - first; ++lane) least[first + lane] = get(lowest, lane);
  for (int i = 0; i < size; ++i)
    for (int j = 0; j <= i; ++j) {
      Pack sum = all(0.0);
      for (int k = 0; k < size; ++k)
        sum += where(eigen.value(k) <= 0.0, all(0.0), eigen.value(k)) * eigen.vector(k)[i] * eigen.vector(k)[j];
      for (int64_t lane = 0; lane < end - first; ++lane) {
        double* matrix = to + (first + lane) * entries;
        matrix[i * size + j] = matrix[j * size + i] = get(sum, lane);
      }
    }
}

void decompose(const double* from, int64_t first, int64_t end, int size, double* values, double* vectors) {
  const Eigen eigen = eigen_of(from, first, end, size);
  for (int64_t lane = 0; lane < end - first; ++lane)
    for (int k = 0; k < size; ++k) {
      values[(first + lane) * size + k] = get(eigen.value(k), lane);
      for (int i = 0; i < size; ++i)
        vectors[((first + lane) * size + i) * size + k] = get(eigen.vector(k)[i], lane);
    }
}

using Numbers = ffi::Buffer<ffi::F64>;

// Runs act(first, end, size) for every pack of matrices.
template <typename Act>
ffi::Error by_packs(ffi::ThreadPool pool, const Numbers& matrices, Act act) {
  const auto shape = matrices.dimensions();
  const int size = static_cast<int>(shape[shape.size() - 1]);
  if (size == 0) return ffi::Error::InvalidArgument("matrices without rows have no eigenvalues");
  const auto count = static_cast<int64_t>(matrices.element_count()) / (static_cast<int64_t>(size) * size);
  parallel_for(pool, (count + kWidth - 1) / kWidth, [&](int64_t pack) {
    const int64_t first = pack * kWidth;
    act(first, std::min(count, first + kWidth), size);
  });
  return ffi::Error::Success();
}

ffi::Error nearest(ffi::ThreadPool pool, Numbers matrices, ffi::Result<Numbers> found, ffi::Result<Numbers> least) {
  return by_packs(pool, matrices, [&](int64_t first, int64_t end, int size) {
    project(matrices.typed_data(), first, end, size, found->typed_data(), least->typed_data());
  });
}

ffi::Error eigen(ffi::ThreadPool pool, Numbers matrices, ffi::Result<Numbers> values, ffi::Result<Numbers> vectors) {
  return by_packs(pool, matrices, [&](int64_t first, int64_t end, int size) {
    decompose(matrices.typed_data(), first, end, size, values->typed_data(), vectors->typed_data());
  });
}

}  // namespace
}  // namespace jaxscp

#define JAXSCP_OF_MATRICES             \
  xla::ffi::Ffi::Bind()                \
      .Ctx<xla::ffi::ThreadPool>()     \
      .Arg<jaxscp::Numbers>()          \
      .Ret<jaxscp::Numbers>()          \
      .Ret<jaxscp::Numbers>()

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_nearest_semidefinite, jaxscp::nearest, JAXSCP_OF_MATRICES);
XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_eigen, jaxscp::eigen, JAXSCP_OF_MATRICES);
