"""The map of the day."""

from datetime import date, datetime, timezone

DAILY = ("skyline_easy", "skyline_medium", "city_small")
"""The tasks of the map of the day, in turn."""


def today() -> date:
    """The date (UTC)."""
    return datetime.now(timezone.utc).date()


def map_of_the_day(day: date) -> tuple[str, int]:
    """The task and the map number of a day (UTC), the same on all servers. The number is the date, such as 20261126."""
    return DAILY[day.toordinal() % len(DAILY)], int(f"{day:%Y%m%d}")
