"""The program `mitsuba-bezier`, one module a command; it alone sets a variant of Mitsuba."""
