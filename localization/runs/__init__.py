"""What a live run leaves: its moments and sums, its picture, and the truth beside them where a simulation tells it."""
