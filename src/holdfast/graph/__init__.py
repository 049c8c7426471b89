"""The only room that builds GTSAM graphs."""
