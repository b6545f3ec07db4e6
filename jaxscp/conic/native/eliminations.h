// The elimination of one panel, as it is done on this machine.
#pragma once

#if defined(__CUDACC__)
#include "elimination_by_warp.h"
#else
#include "elimination.h"
#endif
