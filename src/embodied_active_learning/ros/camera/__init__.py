"""Camera images paired with the arm state at their stamp."""
