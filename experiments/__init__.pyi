from .reports.of_result import report

__all__ = ["report"]
