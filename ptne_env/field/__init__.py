"""More games and laws, of the literature and our own."""
