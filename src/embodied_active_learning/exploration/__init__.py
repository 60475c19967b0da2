"""Where to go next: ergodic control of the entropy target, and the explorers it is compared with."""
