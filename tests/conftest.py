"""What every test needs."""

import signal

# a suite that a shell runs in the background ignores Ctrl-C, and so would every program that it starts
signal.signal(signal.SIGINT, signal.default_int_handler)
