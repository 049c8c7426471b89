"""Random mutation of valid inputs, where there is no coverage to guide it."""

import random
from collections.abc import Sequence

NUMBERS = [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"nan", b"1e999", b"-1", b"\n", b"\0"]


def mutated(randomness: random.Random, pool: Sequence[bytes]) -> bytes:
    """Return one of the inputs, changed in one to eight places."""
    data = bytearray(randomness.choice(pool))
    for _ in range(randomness.randint(1, 8)):
        at, length = randomness.randrange(len(data) + 1), randomness.choice((1, 2, 4, 8, 64))
        action = randomness.randrange(6)
        if action == 0 and at < len(data):
            data[at] ^= 1 << randomness.randrange(8)
        elif action == 1:
            del data[at : at + length]
        elif action == 2:
            data[at:at] = data[at : at + length]
        elif action == 3:
            data[at : at + length] = randomness.randbytes(length)
        elif action == 4:
            number = randomness.choice(NUMBERS)
            data[at : at + len(number)] = number
        else:
            other = randomness.choice(pool)
            begin = randomness.randrange(len(other) + 1)
            data[at : at + length] = other[begin : begin + length]
    return bytes(data)
