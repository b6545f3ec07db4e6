// XLA FFI handler on an NVIDIA GPU.

#include "launch.h"

XLA_FFI_DEFINE_HANDLER_SYMBOL(jaxscp_integrate_on_gpu, jaxscp::launch, jaxscp::launch_binding());
