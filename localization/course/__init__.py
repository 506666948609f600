"""The course of docs/course: checks of the students' functions, and what the notebooks need besides.

tasks       the checks' framework, and `check`, which the notebooks call
sensors     the checks of the notebooks 01 to 03, 10 and 11
estimation  the checks of the notebooks 04 to 09
lab         drives that are recorded, expected ranges, pictures
grading     grades of submissions, each in a process of its own
"""

from localization.course.tasks import check

__all__ = ["check"]
