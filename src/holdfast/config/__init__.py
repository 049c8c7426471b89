"""The configuration: what may stand in the YAML file (`model`), and how the file is read (`load`)."""
