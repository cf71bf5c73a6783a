"""Several causes at once, where no single one mends what measured numbers prove.

A fit that lacks three things is bent by all of them, and none of the three mends it alone.
`beam_search` adds one after the other on many sides at once, from many sizes of each;
`robust_descent` takes a point to the optimum near it, with measurements that nothing explains yet
counting for little.
"""
