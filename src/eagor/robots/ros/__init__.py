"""ROS 2 without ROS: messages, bags, cameras and odometry on topics, and a node that answers.

`messages`: to and from our types. `bags`: recordings. `transforms`, `odometry`: poses from what robots publish.
`topics`: which topic is meant. `sources`: live topics. `playing`: topics of a bag. `answers`: an estimate as messages.
`node`: all of it as a node of the graph.
"""
