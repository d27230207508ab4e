"""The filter works in the memory that it was made with, and nothing in the pipeline grows with time."""

from bench.allocation import filter_growth, pipeline_growth

from drd.samples import Pose

CYCLES = 1500
# Buffers of bounded length that are full at another moment, and counters that leave the cached small integers.
SETTLING_BLOCKS, SETTLING_BYTES = 100, 10_000


def test_no_block_that_a_filter_step_allocates_lives_on() -> None:
    growth = filter_growth(10_000)
    # Fewer: something that lived before was freed meanwhile.
    assert growth.blocks <= 0
    assert growth.size_bytes <= 0


def test_the_pipelines_memory_does_not_grow_with_its_cycles() -> None:
    growth = pipeline_growth(CYCLES)
    assert growth.blocks < SETTLING_BLOCKS
    assert growth.size_bytes < SETTLING_BYTES


def test_poses_that_somebody_keeps_are_noticed() -> None:
    kept: list[Pose] = []
    cycles = 300
    growth = pipeline_growth(cycles, lambda pose, _: kept.append(pose))
    assert growth.blocks > cycles > SETTLING_BLOCKS
    assert len(kept) > cycles
