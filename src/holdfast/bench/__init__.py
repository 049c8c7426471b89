"""Speed: of replays and of the realtime engine, beside a floor in the same run."""
