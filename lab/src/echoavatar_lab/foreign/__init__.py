"""Files of other programs that only research meets: pickled arrays, read without unpickling, and SMPL's.

May import `echoavatar` only.
"""
