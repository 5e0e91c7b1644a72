"""`companion-sitl` as a program whose campaigns fly on stand-ins for the app's processes."""

from functools import partial
from unittest.mock import patch

from sitl.campaign import run
from sitl.campaign.worker import Worker, fly_locally
from sitl.cli import main
from tests.unit.sitl.campaign.fake_flights import COMMAND

if __name__ == "__main__":
    with patch.object(run, "fly_locally", partial(fly_locally, make_worker=partial(Worker, COMMAND))):
        main()
