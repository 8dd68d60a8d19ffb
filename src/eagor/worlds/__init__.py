"""Where panoramas come from when there is no camera: rooms painted by our own code, and single photographs."""
