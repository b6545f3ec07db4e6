"""Inputs of every kind, half of them wrong: each must end in a true plan, a status, or a message."""
