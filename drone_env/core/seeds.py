"""Seeds, their splits, and the counter-based random numbers of maps.

The generator is SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014).
`wrap64`, `mix64`, `map_key` and `next_seed` run interpreted (unbounded integers) and compiled (signed 64-bit integers
that wrap) with equal results: every product is wrapped, every right shift is masked, and every literal fits in a
signed 64-bit integer.
"""

import hashlib
from typing import NamedTuple, SupportsIndex

from drone_env.core.actions import integer
from drone_env.errors import InvalidValueError, UnknownNameError

MASK32 = (1 << 32) - 1
GOLDEN = 0x9E3779B97F4A7C15 - (1 << 64)
MIX_1 = 0xBF58476D1CE4E5B9 - (1 << 64)
MIX_2 = 0x94D049BB133111EB - (1 << 64)

N_SEEDS = 1 << 53
"""Seeds are in [0, 2^53), so JSON, JavaScript and SQLite store them exactly."""

TRAIN_MASK = (1 << 52) - 1
SEED_STRIDE = 0x9E3779B97F4A7
"""Odd, so the walk visits every train seed before it repeats. Near 2^52 / golden ratio, so walks with close starts
diverge (Weyl sequence)."""


class Split(NamedTuple):
    """The seeds in [start, stop)."""

    start: int
    stop: int


SPLITS: dict[str, Split] = {
    "train": Split(0, 1 << 52),
    "validation": Split(1 << 52, (1 << 52) + (1 << 51)),
    "test": Split((1 << 52) + (1 << 51), N_SEEDS),
}
"""The ranges of seeds, by the name of the split."""


def wrap64(x: int) -> int:
    """The low 64 bits of `x`."""
    return (((x >> 32) & MASK32) << 32) | (x & MASK32)


def mix64(z: int) -> int:
    """SplitMix64's finalizer: a bijection of 64-bit integers."""
    z = wrap64((z ^ ((z >> 30) & 0x3FFFFFFFF)) * MIX_1)
    z = wrap64((z ^ ((z >> 27) & 0x1FFFFFFFFF)) * MIX_2)
    return z ^ ((z >> 31) & 0x1FFFFFFFF)


def map_key(task_key: int, seed: int) -> int:
    """The first state of the generator for map `seed`: different for different seeds of one task."""
    return mix64(mix64(seed) ^ task_key)


def next_key(key: int) -> int:
    """The next state of the generator."""
    return wrap64(key + GOLDEN)


def uniform_below(key: int, n: int) -> int:
    """An integer in [0, n) from the generator's state `key`; for n <= 2^16 the bias is below 2^-16 of 1/n."""
    return (((mix64(key) >> 32) & MASK32) * n) >> 32


def two_halves(key: int) -> tuple[int, int]:
    """Two independent random numbers of 32 bits from the generator's state `key`."""
    word = mix64(key)
    return (word >> 32) & MASK32, word & MASK32


def next_seed(seed: int) -> int:
    """The map that follows map `seed` if a reset has no seed: a fixed walk in the train split."""
    return (seed + SEED_STRIDE) & TRAIN_MASK


def task_key(task_id: str, version: int) -> int:
    """A 63-bit hash of a task and its version."""
    digest = hashlib.sha256(f"{task_id}/{version}".encode()).digest()
    return int.from_bytes(digest[:8], "big") >> 1


def check_seed(seed: SupportsIndex) -> int:
    """`seed` as an int.

    Raises:
        InvalidValueError: if it is not an integer in [0, 2^53).
    """
    value = integer(seed)
    if value is None or not 0 <= value < N_SEEDS:
        raise InvalidValueError(f"seed must be an integer in [0, 2^53), got {seed!r}")
    return value


def split_seeds(split: str, episodes: int, offset: int = 0) -> range:
    """The seeds `offset` to `offset + episodes` of a split.

    Raises:
        UnknownNameError: if there is no such split.
        InvalidValueError: if the split has fewer seeds.
    """
    if split not in list(SPLITS):
        raise UnknownNameError("split", split, SPLITS)
    start, stop = SPLITS[split]
    if episodes < 0 or offset < 0 or start + offset + episodes > stop:
        raise InvalidValueError(
            f"split {split!r} has {stop - start} seeds; {episodes} from number {offset} are not in it"
        )
    return range(start + offset, start + offset + episodes)
