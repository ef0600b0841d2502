"""Tables, pages, pictures and videos of results, one module each."""
