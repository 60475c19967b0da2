"""Recording, reading and converting rosbags."""
