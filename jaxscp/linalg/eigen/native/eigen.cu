// The kernel that finds eigenvalues and vectors of symmetric matrices, each by a warp, in the steps of ``eigen.h``. The
// macros are the size of a matrix, and whether its nearest semidefinite matrix is the result.
//
// A lane has one row or column. Matrices stay in shared memory.

constexpr int kSize = JAXSCP_SIZE, kRow = kSize | 1;  // rows of odd length: lanes read a column from different banks
constexpr bool kNearest = JAXSCP_NEAREST;
constexpr unsigned kAllLanes = 0xffffffff;
constexpr double kLargest = 1.7976931348623157e308;
constexpr double kNegligible = 1.1e-16;  // off-diagonal entry, relative to the largest entry
constexpr int kMaxRounds = 40;           // for one eigenvalue, which usually takes two or three

struct Memory {
  double matrix[kSize][kRow], vectors[kSize][kRow];   // eigenvectors are rows
  double values[kSize], off_diagonal[kSize];          // of the tridiagonal matrix
  double weights[kSize], update[kSize];               // of the reflections; of one reflection
};

template <typename Combine>
inline double by_warp(double v, Combine combine) {
  for (int mask = 16; mask > 0; mask /= 2) v = combine(v, __shfl_xor_sync(kAllLanes, v, mask));
  return v;
}
inline double sum_of_warp(double v) {
  return by_warp(v, [](double a, double b) { return a + b; });
}
inline double largest_of_warp(double v) {
  return by_warp(v, [](double a, double b) { return a > b ? a : b; });
}

// Reads a matrix and divides it by its largest entry, the result. NaN if an entry is not finite.
inline double read(Memory& m, int lane, const double* from) {
  double largest = 0.0;
  bool finite = true;
  if (lane < kSize)
    for (int i = 0; i < kSize; ++i) {
      const double entry = 0.5 * (from[i * kSize + lane] + from[lane * kSize + i]), size = fabs(entry);
      finite = finite && size <= kLargest;
      largest = size > largest ? size : largest;
      m.matrix[i][lane] = entry;
    }
  if (__any_sync(kAllLanes, !finite)) return 0.0 / 0.0;
  largest = largest_of_warp(largest);
  if (!(largest > 0.0)) return 1.0;
  const double unit = 1.0 / largest;
  if (lane < kSize)
    for (int i = 0; i < kSize; ++i) m.matrix[i][lane] *= unit;
  __syncwarp();
  return largest;
}

// Reflections I - beta v v' reduce the matrix to tridiagonal form. Each v is stored in the row that it clears.
inline void reduce(Memory& m, int lane) {
  for (int k = 0; k + 1 < kSize; ++k) {
    const bool own = lane > k && lane < kSize;
    double v = own ? m.matrix[k][lane] : 0.0;
    const double square = sum_of_warp(v * v), norm = sqrt(square), first = m.matrix[k][k + 1];
    const double to = first > 0.0 ? -norm : norm, beta = norm > 0.0 ? 1.0 / (square - first * to) : 0.0;
    if (lane == k + 1) v -= to;
    __syncwarp();
    if (own) m.matrix[k][lane] = v;
    if (lane == 0) m.values[k] = m.matrix[k][k], m.off_diagonal[k] = to, m.weights[k] = beta;
    __syncwarp();
    double w = 0.0;  // A - v w' - w v', where w = beta A v - (beta/2 v' beta A v) v
    if (own)
      for (int j = k + 1; j < kSize; ++j) w = fma(m.matrix[j][lane], m.matrix[k][j], w);
    w *= beta;
    w -= 0.5 * beta * sum_of_warp(w * v) * v;
    if (own) m.update[lane] = w;
    __syncwarp();
    if (own)
      for (int i = k + 1; i < kSize; ++i) m.matrix[i][lane] -= m.matrix[k][i] * w + m.update[i] * v;
    __syncwarp();
  }
  if (lane == 0) m.values[kSize - 1] = m.matrix[kSize - 1][kSize - 1];
}

// Product of the reflections; its columns are stored as rows. A lane has a row.
inline void accumulate_reflections(Memory& m, int lane) {
  if (lane < kSize) {
    double* row = m.vectors[lane];
    for (int j = 0; j < kSize; ++j) row[j] = j == lane ? 1.0 : 0.0;
    for (int k = lane - 1; k >= 0; --k) {  // later reflections leave this row as it is
      double sum = 0.0;
      for (int j = k + 1; j < kSize; ++j) sum = fma(row[j], m.matrix[k][j], sum);
      sum *= m.weights[k];
      for (int j = k + 1; j < kSize; ++j) row[j] = fma(-sum, m.matrix[k][j], row[j]);
    }
  }
  __syncwarp();
}

// Eigenvalue of the last two rows' block that is nearer to the last diagonal entry.
inline double wilkinson(const Memory& m, int end) {
  const double e = m.off_diagonal[end - 1], half = 0.5 * (m.values[end - 1] - m.values[end]);
  const double length = sqrt(half * half + e * e), far = half < 0.0 ? half - length : half + length;
  return m.values[end] - (far == 0.0 ? 0.0 : e * e / far);
}

// One QR step for the block from ``first`` to ``end``. A lane has a column of the eigenvectors.
inline void qr_step(Memory& m, int lane, int first, int end) {
  const int column = lane < kSize ? lane : 0;
  double diagonal = m.values[first], off_diagonal = m.off_diagonal[first], of_vector = m.vectors[first][column];
  double x = diagonal - wilkinson(m, end), z = off_diagonal;
  for (int k = first; k < end; ++k) {
    const double after = m.values[k + 1], off_after = k + 1 < end ? m.off_diagonal[k + 1] : 0.0;
    const double next = m.vectors[k + 1][column];
    __syncwarp();
    const double square = x * x + z * z, unit = square > 0.0 ? rsqrt(square) : 0.0;
    const double c = square > 0.0 ? x * unit : 1.0, s = z * unit, twice = 2.0 * c * s * off_diagonal;
    if (lane == 0) {
      m.values[k] = c * c * diagonal + twice + s * s * after;
      if (k > first) m.off_diagonal[k - 1] = square * unit;
    }
    if (lane < kSize) m.vectors[k][lane] = c * of_vector + s * next;
    of_vector = c * next - s * of_vector;
    x = c * s * (after - diagonal) + (c * c - s * s) * off_diagonal;
    diagonal = s * s * diagonal - twice + c * c * after;
    z = s * off_after, off_diagonal = c * off_after;
  }
  if (lane == 0) m.values[end] = diagonal, m.off_diagonal[end - 1] = x;
  if (lane < kSize) m.vectors[end][lane] = of_vector;
  __syncwarp();
}

// QR iteration: eigenvalues converge at the end of the diagonal, one after another.
inline void iterate(Memory& m, int lane) {
  const double value = lane < kSize ? fabs(m.values[lane]) : 0.0;
  const double beside = lane + 1 < kSize ? fabs(m.off_diagonal[lane]) : 0.0;
  const double negligible = kNegligible * largest_of_warp(value > beside ? value : beside);
  for (int end = kSize - 1; end > 0; --end)
    for (int round = 0; round < kMaxRounds; ++round) {
      // the block begins after the last negligible off-diagonal entry
      const bool small = lane < end && !(fabs(m.off_diagonal[lane]) > negligible);
      const unsigned all_small = __ballot_sync(kAllLanes, small);
      if (all_small >> (end - 1)) break;
      qr_step(m, lane, 32 - __clz(all_small), end);
      if (lane < end && fabs(m.off_diagonal[lane]) <= negligible) m.off_diagonal[lane] = 0.0;
      __syncwarp();
    }
}

// The sum of eigenvalue times vector times vector' over the positive eigenvalues, and the lowest eigenvalue.
inline void write_nearest(Memory& m, int lane, double size, double* to, double* least) {
  const bool own = lane < kSize;
  const double value = own ? m.values[lane] : kLargest, lowest = -largest_of_warp(-value);
  if (lane == 0) *least = lowest * size;
  if (own) m.weights[lane] = value > 0.0 ? sqrt(value * size) : 0.0;
  __syncwarp();
  double scaled[kSize];  // a column of the eigenvectors times roots of their eigenvalues
#pragma unroll
  for (int k = 0; k < kSize; ++k) scaled[k] = m.weights[k] * m.vectors[k][own ? lane : 0];
  __syncwarp();
#pragma unroll
  for (int k = 0; k < kSize; ++k)
    if (own) m.vectors[k][lane] = scaled[k];
  __syncwarp();
  if (own)
    for (int i = 0; i < kSize; ++i) {
      double sum = 0.0;
#pragma unroll
      for (int k = 0; k < kSize; ++k) sum = fma(scaled[k], m.vectors[k][i], sum);
      to[i * kSize + lane] = sum;
    }
}

// Eigenvalues, and eigenvectors as columns.
inline void write_eigen(const Memory& m, int lane, double size, double* values, double* vectors) {
  if (lane < kSize) {
    values[lane] = m.values[lane] * size;
    for (int i = 0; i < kSize; ++i) vectors[i * kSize + lane] = m.vectors[lane][i];
  }
}

extern "C" __global__ void __launch_bounds__(32)
    jaxscp_kernel(const double* __restrict__ from, double* __restrict__ first, double* __restrict__ second, long long,
                  long long) {
  constexpr int kEntries = kSize * kSize;
  __shared__ Memory m;
  const long long matrix = blockIdx.x;
  const int lane = threadIdx.x;
  first += matrix * (kNearest ? kEntries : kSize), second += matrix * (kNearest ? 1 : kEntries);
  const double size = read(m, lane, from + matrix * kEntries);
  if (!(size > 0.0)) {
    for (int i = lane; i < (kNearest ? kEntries : kSize); i += 32) first[i] = size;
    for (int i = lane; i < (kNearest ? 1 : kEntries); i += 32) second[i] = size;
    return;
  }
  reduce(m, lane);
  accumulate_reflections(m, lane);
  iterate(m, lane);
  if (kNearest)
    write_nearest(m, lane, size, first, second);
  else
    write_eigen(m, lane, size, first, second);
}
