//
// State_Off.h
//
// Automatically created through MiCASE -- do not change manually!
//
            class Off: public CLState
            {
                class Transition_0: public CLTransition
                {
                public:
                    Transition_0(int toState = 2): CLTransition(toState) {}

                    virtual bool check(CLMachine *, CLState *) const;
                };

                class Transition_1: public CLTransition
                {
                public:
                    Transition_1(int toState = 4): CLTransition(toState) {}

                    virtual bool check(CLMachine *, CLState *) const;
                };

                CLTransition *_transitions[2];

                public:
                    Off(const char *name = "Off");

                    virtual int numberOfTransitions() const { return 2; }

#                   include "State_Off_Variables.h"
            };
