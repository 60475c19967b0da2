"""What every node needs: start and shutdown, diagnostics, services, timers and logging."""
