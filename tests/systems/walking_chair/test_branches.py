from parapod.systems.walking_chair.geometry import BRANCHES, branch_names


def test_branches_are_named_by_leg_and_number():
    assert len(BRANCHES) == 12
    assert BRANCHES[:4] == ("branch 11", "branch 12", "branch 13", "branch 21")
    assert BRANCHES[-1] == "branch 43"


def test_names_of_chosen_legs_alone():
    assert branch_names((3,)) == ("branch 31", "branch 32", "branch 33")
