// Shared memory of a block: scratch of each warp, a tile of each warp for elimination, and buffers into which the two
// warps of the chain copy blocks before their use.
#pragma once

#include "layout.h"
#include "parallel.h"

namespace jaxscp {

constexpr int larger_of(int a, int b) { return a > b ? a : b; }
constexpr int kWarpScratch = 4 * larger_of(kLayout.n, kLayout.m);
constexpr int even(int count) { return (count + 1) / 2 * 2; }  // size that can be copied in pairs
// Numbers of a node's factor; a tile holds two.
constexpr int kTriangle = even(kLayout.n * (kLayout.n + 1) / 2);
constexpr int kTileSize = even(larger_of(2 * kTriangle, larger_of(kLayout.n * kLayout.n, kLayout.m * kLayout.m)));

// Blocks of the chain are stored in tiles of eight rows and columns, row by row, in the layout of the tensor cores'
// sums: lane l holds two neighbours, at 2 l. Of a symmetric block, only the lower tiles are stored.
constexpr int kTile = 64, kAcross = (kLayout.m + 7) / 8, kPadded = 8 * kAcross;
constexpr int kLower = kAcross * (kAcross + 1) / 2 * kTile, kSquare = kAcross * kAcross * kTile;
constexpr int lower_tile(int s, int t) { return (s * (s + 1) / 2 + t) * kTile; }
constexpr int square_tile(int s, int t) { return (s * kAcross + t) * kTile; }
constexpr int kPerLink = 2 * kLower + kSquare;

// By a team, calls act(tile, i, j) for each lower tile, with the tile's position, the lane's row i and the first of the
// lane's two columns j.
template <typename Act>
inline void each_lower_tile(Act act) {
  const int row = lane_of_warp() / 4, column = lane_of_warp() % 4 * 2;
#pragma unroll
  for (int s = 0; s < kAcross; ++s)
#pragma unroll
    for (int t = 0; t <= s; ++t) act(lower_tile(s, t), 8 * s + row, 8 * t + column);
}

constexpr int kLine = 16;  // numbers of a memory transaction, if aligned
constexpr int kBlockSize = (kLayout.m * kLayout.m + kLine - 1) / kLine * kLine;  // of a block stored by columns
constexpr int kBuffers = 3;  // blocks of the chain in use or being copied
constexpr int kPrefetched = larger_of(kPerLink, kBuffers * kBlockSize);  // of one end of the chain
// Solutions of the chain for two right-hand sides, and the updates of its middle; in shared memory if they fit.
constexpr int kSolutions = 2 * (kLayout.nodes + 3) * kLayout.m;
// Two warps eliminate the chain in their tiles; their copies lie in the other warps' tiles.
constexpr int shared_memory_size(int warps, int of_vectors) {
  return warps * kWarpScratch + of_vectors +
         larger_of(larger_of(warps, 2) * kTileSize, 2 * (kTileSize + kPrefetched));
}
// Blocks share a multiprocessor, as many as fit: one more is worth more than faster access to the chain's vectors.
// ``kObjects``: bytes of the objects in shared memory (``kernel.cu``), about; ``kLeastForIndices``: for ``indices.h``.
constexpr int kReserved = 1024, kObjects = 8192, kLeastForIndices = 1536;
constexpr int left_for_indices(int blocks, int of_vectors) {
  const int numbers = shared_memory_size(JAXSCP_THREADS / kWarp, of_vectors);
  return JAXSCP_SHARED / blocks - kReserved - kObjects - static_cast<int>(sizeof(double)) * numbers;
}
constexpr int most_blocks() {
  int blocks = JAXSCP_BLOCKS;
  while (blocks > 1 && left_for_indices(blocks, 0) < kLeastForIndices) --blocks;
  return blocks;
}
constexpr bool kVectorsShared = left_for_indices(most_blocks(), kSolutions) >= kLeastForIndices;
constexpr int kChainVectors = kVectorsShared ? kSolutions : 0;
constexpr int kForIndices = larger_of(left_for_indices(most_blocks(), kChainVectors), kLeastForIndices);
constexpr int shared_memory_size(int warps) { return shared_memory_size(warps, kChainVectors); }

#if defined(JAXSCP_EMULATED_GPU)
inline double* shared_memory() {
  alignas(16) static double memory[shared_memory_size(kMostWarps)];
  return memory;
}
inline void copy_async(double* to, const double* from, int count) {
  in_team(count, [&](int i) { to[i] = from[i]; });
}
inline void put_pair(double* to, double first, double second) { to[0] = first, to[1] = second; }
template <int kLeft>
inline void wait_for_copies() {
  __syncwarp();
}
#else
extern __shared__ double2 jaxscp_shared[];
inline double* shared_memory() { return reinterpret_cast<double*>(jaxscp_shared); }

// Begins to copy an even count of numbers to shared memory; both addresses are aligned to pairs.
inline void copy_async(double* to, const double* from, int count) {
#pragma unroll 4
  for (int i = 2 * lane_of_warp(); i < count; i += 2 * kWarp)
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(
                     static_cast<unsigned>(__cvta_generic_to_shared(to + i))),
                 "l"(__cvta_generic_to_global(from + i))
                 : "memory");
  asm volatile("cp.async.commit_group;" ::: "memory");
}
// Writes two neighbours, the first at an even position.
inline void put_pair(double* to, double first, double second) {
  *reinterpret_cast<double2*>(to) = double2{first, second};
}
// Waits until at most kLeft copies are under way, the last ones.
template <int kLeft>
inline void wait_for_copies() {
  asm volatile("cp.async.wait_group %0;" ::"n"(kLeft) : "memory");
  __syncwarp();
}
#endif

inline double* warp_scratch() { return shared_memory() + warp_of_block() * kWarpScratch; }
inline double* chain_vectors() { return shared_memory() + warps() * kWarpScratch; }
inline double* tiles() { return chain_vectors() + kChainVectors; }
inline double* warp_tile() { return tiles() + warp_of_block() * kTileSize; }
inline double* prefetched(int end) { return tiles() + 2 * kTileSize + end * kPrefetched; }

}  // namespace jaxscp
