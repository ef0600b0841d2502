"""Tables, pages, pictures and videos of results."""
