// Nodes and the chain of their links, eliminated as it is done on this machine.
#pragma once

#if defined(__CUDACC__)
#include "nodes_by_warps.h"
#else
#include "nodes_by_panels.h"
#endif
