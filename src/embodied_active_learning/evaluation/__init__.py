"""Peers, statistics and bounds that the experiments compare the method with; no run needs them."""
