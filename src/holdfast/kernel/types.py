"""Types of arguments and answers, for signatures."""

import numba

VOID, BOOL, INT64, FLOAT64 = numba.void, numba.boolean, numba.int64, numba.float64
VECTOR = numba.types.Array(FLOAT64, 1, "A")
READING = numba.types.UniTuple(FLOAT64, 6)  # specific force [m/s^2], angular velocity [rad/s]
PAIR, TRIPLE = numba.types.UniTuple(FLOAT64, 2), numba.types.UniTuple(FLOAT64, 3)
UNTIL = numba.types.Tuple((INT64, BOOL))  # a time [ns] and a flag
FLOATS = numba.types.Array(FLOAT64, 1, "C")
INTS = numba.types.Array(INT64, 1, "C")
