"""What outlasts a daemon: the whole of it saved, and what was said in it.

snapshot > snapshot_objects, trial     saved and put back to the bit; autosave: again and again
recording; replay                      what was said, and whether it is said again
"""
