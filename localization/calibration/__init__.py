"""What a robot's wheels and sonars get wrong every time: found out on a guided run, and written as a model file."""
