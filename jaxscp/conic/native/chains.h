#pragma once

#if defined(__CUDACC__)
#include "chain_by_halves.h"
#else
#include "chain_from_ends.h"
#endif
