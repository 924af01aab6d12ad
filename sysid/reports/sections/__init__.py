"""One section a file, beside its template."""
