"""The trade-off surface: all that a user can turn, what it costs and what it is worth."""
