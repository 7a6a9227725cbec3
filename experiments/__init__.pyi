from .exports.workflow import export
from .reports.of_result import report, section
from .reports.page.sections import page_section

__all__ = ["export", "page_section", "report", "section"]
