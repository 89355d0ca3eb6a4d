"""What the pages over a store may do in a browser; the guard lets no other policy by.

Pages that are made now run no script. A page that is stored may be of another store
and another author (`modelgap unbundle`), and may have scripts, for its curves: it gets
an origin of its own, which has no key, no storage, and may ask this server nothing.
"""

_NO = "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
MADE = f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; {_NO}"
STORED = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    f"style-src 'unsafe-inline'; img-src data: blob:; font-src data:; {_NO}"
)
# Without a key: a page with nothing in it, whose script asks for a ticket.
DOOR = (
    "default-src 'none'; script-src 'self'; connect-src 'self'; "
    f"img-src data:; style-src 'unsafe-inline'; {_NO}"
)
KNOWN = frozenset({MADE, STORED, DOOR})
