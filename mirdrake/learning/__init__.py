"""Networks that drive: data from recorded pictures, behavioural cloning, DAgger."""

from mirdrake.learning.data import DrivingData as DrivingData
from mirdrake.learning.data import driving_data as driving_data
