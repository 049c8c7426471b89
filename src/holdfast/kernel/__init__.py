"""The IMU path as compiled code: pure functions of numbers and of the records that `layout` lists.

`compiling` says how they are compiled. Nothing here knows a message, a configuration or GTSAM; the rooms above own the
records, fill in what the configuration says, and call the functions.
"""
