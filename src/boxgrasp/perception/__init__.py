"""From a view to the support plane, the objects on it, the target and its box."""
