"""Version of the store's tables.

The table ``tandem_schema`` holds the version number. A store of any other version is refused: there are no
migrations between versions.
"""

from typing import Final

from sqlalchemy import Connection, MetaData, inspect, text

VERSION: Final = 8
"""Version of the tables that this program reads and writes. Increase it with every change of the tables."""
_MARKERS: Final = frozenset({"tandem_schema", "tandem_jobs"})
"""Tables whose presence means that the database contains a store."""


class SchemaVersionError(Exception):
    """The store has tables of a version that this program does not support.

    The message has no subject and no full stop, so that callers can put both around it.

    Attributes:
        version: Version of the store.
    """

    def __init__(self, version: int) -> None:
        self.version = version
        super().__init__(f"has tables of version {version} (expected {VERSION})")

    @property
    def remedy(self) -> str:
        """What the operator of the service can do."""
        if self.version > VERSION:
            return f"Update tandem-planner on this machine, or restore a backup of version {VERSION}."
        return (
            "Older versions are not migrated. Use an empty data folder or database, "
            "or the version of tandem-planner that created this store."
        )


class NoVersionError(Exception):
    """The database contains a store without a valid version number."""

    def __init__(self) -> None:
        super().__init__("table tandem_schema has no valid version number")


def has_store(connection: Connection) -> bool:
    """Report whether the database contains a store, whatever its version."""
    return not _MARKERS.isdisjoint(inspect(connection).get_table_names())


def version_of(connection: Connection) -> int | None:
    """Read the version of the store.

    Returns:
        Version number, or None if the database contains no store.

    Raises:
        NoVersionError: The store has no valid version number.
    """
    table_names = set(inspect(connection).get_table_names())
    if "tandem_schema" not in table_names:
        if _MARKERS.isdisjoint(table_names):
            return None
        raise NoVersionError
    version = connection.execute(text("SELECT max(version) FROM tandem_schema")).scalar_one()
    if not isinstance(version, int) or version < 1:
        raise NoVersionError
    return version


def create_or_check(connection: Connection, tables: MetaData) -> None:
    """Create the tables in an empty database, or check the version of an existing store.

    Both happen in the transaction of the connection. An existing store is not changed.

    Args:
        connection: Open write transaction.
        tables: All tables of the store.

    Raises:
        SchemaVersionError: The store has another version.
        NoVersionError: The store has no valid version number.
    """
    version = version_of(connection)
    if version is None:
        tables.create_all(connection)
        connection.execute(text("INSERT INTO tandem_schema (version) VALUES (:v)"), {"v": VERSION})
    elif version != VERSION:
        raise SchemaVersionError(version)
