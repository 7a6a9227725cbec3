from .reports.of_result import report, section

__all__ = ["report", "section"]
