"""The files of ROS recordings, read record by record: what is damaged costs itself, and nothing is taken on trust."""
