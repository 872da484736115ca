"""Meet rays and leaves on the device: buffers, traversal of the BVH, one module a kind."""
