"""The parts of `latency_720p.py`: the methods it times, where their time goes, and its tables."""
