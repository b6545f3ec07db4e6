#pragma once

#if defined(__CUDACC__)
#include "chain_by_warps.h"
#else
#include "chain_from_ends.h"
#endif
