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

// Runs act(matrices, first, end, size, first result, second result) for every pack of matrices.
using Act = void(const double*, int64_t, int64_t, int, double*, double*);
void by_packs(const Call& call, Act act) {
  call.expect(1, 2);
  const Array matrices = call.argument(0);
  const int size = matrices.from_last(1);
  if (size == 0) throw invalid("matrices without rows have no eigenvalues");
  const int64_t count = matrices.size() / (static_cast<int64_t>(size) * size);
  const double* from = matrices.numbers<double>();
  double *const first_result = call.result(0).numbers<double>(), *const second_result = call.result(1).numbers<double>();
  parallel_for(call, (count + kWidth - 1) / kWidth, [&](int64_t pack) {
    const int64_t first = pack * kWidth;
    act(from, first, std::min(count, first + kWidth), size, first_result, second_result);
  });
}

void nearest(Call& call) { by_packs(call, project); }
void eigen(Call& call) { by_packs(call, decompose); }

}  // namespace
}  // namespace jaxscp

JAXSCP_HANDLER(jaxscp_nearest_semidefinite, jaxscp::nearest);
JAXSCP_HANDLER(jaxscp_eigen, jaxscp::eigen);
