"""What fingerprinter and identifier do beyond the library: move the arm, read new images, publish and report."""
