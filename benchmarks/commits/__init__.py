"""Two commits compared on one machine in one run: their numbers, bit by bit, and their times, in turns."""
