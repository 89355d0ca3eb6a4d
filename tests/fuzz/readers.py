"""All readers, by name; a new format gets an entry in a file of its family."""

from tests.fuzz.logs import LOGS
from tests.fuzz.records import RECORDS
from tests.fuzz.store import STORES
from tests.fuzz.tables import TABLES

READERS = {reader.name: reader for reader in (*LOGS, *TABLES, *RECORDS, *STORES)}
