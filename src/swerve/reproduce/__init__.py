"""Published results, regenerated from nothing; one module each."""
