"""What every test needs."""

import signal

from hypothesis import settings

# a suite that a shell runs in the background ignores Ctrl-C, and so would every program that it starts
signal.signal(signal.SIGINT, signal.default_int_handler)

# a busy machine is no mistake of the code
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")
