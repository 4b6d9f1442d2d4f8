"""Who could reach a service: one that others can is not started without a key, unless its owner says so."""

from ipaddress import ip_address

from sqlalchemy.exc import SQLAlchemyError

from equimesh_service.errors import ExposedError
from equimesh_service.settings import Settings
from equimesh_service.store.store import Store


def check_exposure(settings: Settings) -> None:
    """Nothing for a service that only this machine reaches, or that has keys, or that may be open to all.

    Raises :class:`ExposedError` for any other, and :class:`~equimesh_service.errors.UnusableDatabaseError`;
    makes the database if it is not there.
    """
    if settings.allow_anonymous or is_loopback(settings.host):
        return
    store = Store(settings.database)
    try:
        store.prepare()
        guarded = store.keys.exist()
    except SQLAlchemyError as error:
        raise ExposedError(
            f"whether there are API keys is not known, as the database does not answer ({type(error).__name__}): "
            f"{settings.host} is not served before it does"
        ) from None
    finally:
        store.close()
    if not guarded:
        where = "" if settings.database_url.get_secret_value() else f" --data-dir {settings.data_dir}"
        raise ExposedError(
            f"other machines reach {settings.host or 'every address'}, and there is no API key: make one with "
            f"`equimesh keys create --name NAME --scope write{where}`, or let anyone in with --allow-anonymous true "
            "(EQUIMESH_ALLOW_ANONYMOUS=true), or listen on 127.0.0.1"
        )


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address; names are taken for public, but for localhost."""
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]").partition("%")[0]).is_loopback
    except ValueError:
        return False
