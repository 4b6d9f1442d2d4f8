"""Line corrections, the fast solver of the equations."""
