"""Gram matrices J' W J of linear rows J with weights W at every node or interval, and products J' v."""
