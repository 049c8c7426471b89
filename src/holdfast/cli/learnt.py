"""What the commands say of `--learnt`."""

LEARNT_HELP = "What was learnt of the sensors: read if it is there, written at the end. A day begins where one ended."
