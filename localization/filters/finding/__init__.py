"""Where else the robot may be: the filter that knows when it is lost.

finder > contest > search > atlas    several places while they look alike, told apart by what is heard from now on
"""
