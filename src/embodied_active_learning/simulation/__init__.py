"""A PyBullet stand-in for the arm, its wrist camera and the table under it."""
