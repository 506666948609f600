"""Who may come in, and what a client may take.

limits                             every limit with its default, in one table
door                               who is let in to a port, by nclient.access and the limits
descriptors                        that there is room for as many
allowance, patience                how often one may ask, how long one may be silent
"""
