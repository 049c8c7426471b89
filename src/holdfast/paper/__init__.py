"""The paper's evaluation, rebuilt: every system on every recording, tables and figures as data."""
