"""The course of docs/course: checks of the students' functions, and what the notebooks need besides.

tasks       the checks' framework, and `check`, which the notebooks call
sensors, estimation, particles, surveying
the checks of the notebooks 01 to 03, 04 to 07, 08 and 09, 10 and 11
lab         drives that are recorded, expected ranges, pictures
submission  the functions of a student's notebook, for grading
grading     grades of submissions, each in a process of its own
"""

from localization.course.tasks import check

__all__ = ["check"]
