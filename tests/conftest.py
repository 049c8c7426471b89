"""What every test needs."""

import os
import signal

from hypothesis import settings

# a suite that a shell runs in the background ignores Ctrl-C, and so would every program that it starts
signal.signal(signal.SIGINT, signal.default_int_handler)

# no deadline: a busy machine is no fault of the code
settings.register_profile("same", derandomize=True, deadline=None, database=None, max_examples=50)
settings.register_profile("fuzz", deadline=None, max_examples=1000)
settings.load_profile("fuzz" if os.environ.get("HOLDFAST_FUZZ") else "same")
