"""Files for other programs: one module for each format, and the table of formats in `formats`."""
