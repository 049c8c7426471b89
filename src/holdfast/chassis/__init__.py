"""The chassis below a turning cabin: its pose and twist, from the cabin, the encoder and a gyroscope."""
