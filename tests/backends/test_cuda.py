"""Blocks that share a multiprocessor of an NVIDIA GPU; no GPU is needed."""

import pytest

from jaxscp.backends import cuda


@pytest.mark.parametrize("capability", ["80", "86", "90"])
def test_blocks_fit_into_a_multiprocessor_and_one_more_would_not(capability):
    """CUDA takes 1 KiB of each block (CUDA C++ Programming Guide, "Shared Memory" of each capability)."""
    whole = cuda.shared_memory_of_multiprocessor(capability)
    for shared in (20_000, 43_008, cuda.shared_memory(capability)):
        count = cuda.blocks(capability, shared, threads=32)
        assert count * (shared + 1024) <= whole
        assert count == cuda.MOST_BLOCKS or (count + 1) * (shared + 1024) > whole


def test_the_largest_block_is_alone():
    assert cuda.blocks("90", cuda.shared_memory("90"), threads=32) == 1


def test_threads_keep_their_registers():
    assert (
        cuda.blocks("90", shared=1000, threads=128) * 128 * cuda.REGISTERS <= cuda.REGISTERS_OF_MULTIPROCESSOR
    )
    assert cuda.blocks("90", shared=1000, threads=1024) == 1
