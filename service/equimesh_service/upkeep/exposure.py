"""Exposure: a service that other machines can reach needs an API key, unless its settings allow anyone."""

from ipaddress import ip_address

from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.errors import ExposedError
from equimesh_service.settings import Settings
from equimesh_service.store.store import Store


def check_exposure(settings: Settings) -> None:
    """Raise :class:`ExposedError` if other machines can reach the service without a key, and the settings forbid it.

    Creates the database if it does not exist; raises :class:`~equimesh_service.errors.UnusableDatabaseError`.
    """
    if settings.allow_anonymous or is_loopback(settings.host):
        return
    store = Store(settings.database)
    try:
        store.prepare()
        guarded = store.keys.exist()
    except SQLAlchemyError as error:
        raise ExposedError(
            f"the database does not answer ({type(error).__name__}), so API keys cannot be looked up: "
            f"{settings.host} is not served before it does"
        ) from None
    finally:
        store.close()
    if not guarded:
        where = "" if settings.database_url.get_secret_value() else f" --data-dir {settings.data_dir}"
        raise ExposedError(
            f"other machines can reach {settings.host or 'every address'}, and there is no API key: make one with "
            f"`equimesh keys create --name NAME --scope write{where}`, or let anyone in with --allow-anonymous true "
            "(EQUIMESH_ALLOW_ANONYMOUS=true), or listen on 127.0.0.1"
        )


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach an address; all names but localhost count as public."""
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]").partition("%")[0]).is_loopback
    except ValueError:
        return False
