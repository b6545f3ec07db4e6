// Elimination of the nodes and links, for a GPU or a CPU.
#pragma once

#if defined(__CUDACC__)
#include "nodes_by_warps.h"
#else
#include "nodes_by_panels.h"
#endif
