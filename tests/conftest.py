"""Test settings: double precision, strict dtypes, and every annotation of the package checked at run time."""

import jax
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
install_import_hook("jaxscp", "beartype.beartype")
