// XLA FFI handler on an NVIDIA GPU.

#include "launch.h"

JAXSCP_HANDLER(jaxscp_gram_on_gpu, jaxscp::launch);
