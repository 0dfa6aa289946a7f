"""The chapters that the report has: one a machine."""

from parapod.sims.report.chapter import Chapter


def chapters() -> tuple[Chapter, ...]:
    """All chapters, in order."""
    from parapod.sims.report.levelling_platform.chapter import CHAPTER as LEVELLING_PLATFORM
    from parapod.sims.report.walking_chair.chapter import CHAPTER as WALKING_CHAIR

    return LEVELLING_PLATFORM, WALKING_CHAIR
