"""People's tracks through a room: the obstacle that they walk around."""
