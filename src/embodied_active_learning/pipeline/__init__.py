"""The four runs: exploration, training, fingerprinting and identification, without ROS."""
