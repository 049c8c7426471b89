"""One file per sensor: how its messages are checked, and how they become noise models and factors."""
