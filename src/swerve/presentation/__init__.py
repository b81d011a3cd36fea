"""Say, draw and report an answer; compute nothing."""
